"""One simulated run: its case, its scan over the periods, and its result."""
