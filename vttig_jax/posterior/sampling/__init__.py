"""Ensemble sampling with checkpoints and convergence tests."""
