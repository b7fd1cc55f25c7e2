"""The standard errors of a run that has not been recorded yet."""
