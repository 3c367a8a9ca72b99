"""Simulation of models driven by sampled inputs, and the inputs to drive them with."""
