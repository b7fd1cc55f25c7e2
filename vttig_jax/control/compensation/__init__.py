"""Harmonics of a backlash map for use in a controller, and their C header."""
