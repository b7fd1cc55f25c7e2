"""Backlash from the tooth thickness of both gears."""
