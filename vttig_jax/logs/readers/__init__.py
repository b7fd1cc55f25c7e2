"""Readers of text, MATLAB and HDF5 files, and the assignment of roles to columns."""
