"""Flank models: transmission error and backlash of an eccentric pair, as pure functions."""
