"""Analyses: functions of a Linearisation that return frozen results; none of them knows a model or a solver."""
