"""One simulated run: build, scan and result."""
