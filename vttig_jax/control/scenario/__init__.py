"""The scenario file: keys, defaults and axes of a sweep."""
