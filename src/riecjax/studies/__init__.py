"""Repeated experiments over many seeds and roads."""
