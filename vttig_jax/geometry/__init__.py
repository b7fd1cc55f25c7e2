"""Geometry: from the rack to the tooth, its measures, and the contact of two of them."""
