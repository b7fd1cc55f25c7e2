"""What the shafts did: constant-speed segments, flanks in contact, ramps."""
