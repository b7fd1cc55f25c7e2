"""The linear mixed model of two encoder channels: rows, one density, functionals."""
