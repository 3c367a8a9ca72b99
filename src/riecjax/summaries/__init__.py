"""Sums that hold all that a recording says to a model: the Summary, and the pass that makes it."""
