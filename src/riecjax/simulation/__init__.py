"""Simulation of models driven by sampled inputs, and the inputs to drive them with."""

from riecjax.public_names import attach

__getattr__, __dir__ = attach(__name__, __file__)
