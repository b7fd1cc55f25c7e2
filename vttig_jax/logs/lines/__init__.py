"""The search for periodic lines in a residual."""
