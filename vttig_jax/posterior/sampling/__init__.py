"""Ensemble sampling with checkpoints and tests of convergence."""
