"""Tuning the settings of a controller."""
