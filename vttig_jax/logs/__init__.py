"""Encoder logs: reading, unwrapping, segments, inspection. Needs no jax."""
