"""Many logs at once: a fit as a pure function of arrays, and a table with one row per log."""
