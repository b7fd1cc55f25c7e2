"""The posterior of a fit: sampling, bands, calibration, and the plan of a run."""
