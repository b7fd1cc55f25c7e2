"""Compensation tables and the C header."""
