"""Scenario file: keys, defaults and axes of a sweep."""
