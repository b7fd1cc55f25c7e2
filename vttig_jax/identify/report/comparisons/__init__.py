"""Comparisons: parts of a log, several logs, and backlash readings with the fitted backlash."""
