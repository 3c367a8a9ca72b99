"""Equations of motion, linear in their parameters, as sums of terms."""
