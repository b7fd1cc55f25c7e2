"""Sweeps of many cases in batches, with their folder and their table."""
