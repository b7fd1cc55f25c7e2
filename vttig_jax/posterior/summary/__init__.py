"""What the draws say: parameters, bands, predictions."""
