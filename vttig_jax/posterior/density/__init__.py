"""The posterior density: prior, likelihood and profile likelihood."""
