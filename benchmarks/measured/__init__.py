"""Figures on measured recordings, which the README and tests quote."""
