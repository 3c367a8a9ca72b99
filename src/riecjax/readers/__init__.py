"""Readers of binary formats and spreadsheets, each imported where a file of it is read."""
