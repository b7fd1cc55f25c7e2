"""The model of a fit: harmonics, columns, and the forward model of the pair."""
