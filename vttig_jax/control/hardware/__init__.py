"""Encoders, observers, actuator and servo drive."""
