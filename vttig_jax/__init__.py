"""Transmission error and backlash."""
