"""One simulated run: its case, its loop over the controller periods, and its result."""
