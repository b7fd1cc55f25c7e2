"""Checks of a log before a fit: sampling, ratio, slips and order spectrum."""
