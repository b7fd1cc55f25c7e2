"""Calibration: test whether nominal 95 % intervals contain the true value in 95 % of the rigs."""
