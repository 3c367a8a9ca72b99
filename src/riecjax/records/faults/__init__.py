"""Faults of sensors, converters and loggers, one module for each."""
