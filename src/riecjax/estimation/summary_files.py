"""Summaries in files."""
