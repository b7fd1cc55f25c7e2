"""Meshes, CAD solids and section drawings of a gear."""
