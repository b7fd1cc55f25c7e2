"""The noise model and its restricted maximum likelihood."""
