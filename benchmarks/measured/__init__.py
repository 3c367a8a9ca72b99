"""Figures on measured recordings, which docs/measured.md and tests quote."""
