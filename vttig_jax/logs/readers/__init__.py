"""Files to tables: text, MATLAB and HDF5, and the roles of their columns."""
