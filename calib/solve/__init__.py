"""Solvers: each takes a declared problem and returns an Estimate whose certificate is computed apart."""
