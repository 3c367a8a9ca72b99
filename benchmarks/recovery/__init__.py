"""Machines with known parameters, faults of their recordings, and what is said of them."""
