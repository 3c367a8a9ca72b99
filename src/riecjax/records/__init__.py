"""Recordings: uniformly sampled named signals, read, checked and prepared once."""
