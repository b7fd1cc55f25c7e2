"""Search for lines, periodic parts of unknown frequency, in a transmission error or a residual."""
