"""Readers of binary formats; each imports its library when a file of its format is read."""
