"""Tuning of the settings of a controller: gradient search and full simulation."""
