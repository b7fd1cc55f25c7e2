"""Motion of the shafts: segments of steady speed, flanks in contact, and ramps."""
