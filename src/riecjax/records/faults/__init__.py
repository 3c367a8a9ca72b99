"""Faults of recordings, each found by a module that is named for it."""
