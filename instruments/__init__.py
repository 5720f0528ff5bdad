"""Instruments, one file each: model functions with slots, stated uncertainties with their source, and named effects.

A module offers its models, its stated-uncertainty functions, `effects(...) -> tuple[Effect, ...]` and `example(seed)
-> Problem`. A new instrument is one more file; nothing lists them.
"""
