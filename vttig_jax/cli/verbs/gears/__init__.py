"""Verbs of gears and their teeth: what a shop measures, surfaces, contact."""
