"""File formats: atomic writes, run folders, JSON, TOML and text tables."""
