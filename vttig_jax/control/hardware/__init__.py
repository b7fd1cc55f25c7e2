"""Encoders, observer, actuator and servo drive."""
