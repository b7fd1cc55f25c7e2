"""Calibration: whether nominal 95 % intervals contain the truth in 95 % of the rigs."""
