"""Scenario of a simulation: objects, keys of its file, defaults and axes of a sweep."""
