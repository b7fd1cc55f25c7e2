"""Ground floor: units, angles, errors, JSON, text tables, run folders, sine and cosine."""
