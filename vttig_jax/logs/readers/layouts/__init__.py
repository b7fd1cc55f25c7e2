"""Recognisers of the text layouts of recording programs, which say what they saw."""
