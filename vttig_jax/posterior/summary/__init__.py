"""Parameters, bands and predictions from the draws of a posterior."""
