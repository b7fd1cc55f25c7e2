"""From the log to parameters: harmonic summary, noise, least squares, rank in words."""
