"""Search for periodic lines in the transmission error or a residual."""
