"""Commanded and recorded motions of the driving shaft."""
