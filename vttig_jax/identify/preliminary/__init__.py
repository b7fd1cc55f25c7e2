"""Preliminary linear fit: alignment, delay, drift and outliers."""
