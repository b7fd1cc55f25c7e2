"""The linear fit that comes first: alignment, delay, drift and outliers."""
