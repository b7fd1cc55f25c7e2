"""Expected standard errors of a run before it is recorded."""
