"""What the drawing says: gears, gear pair, eccentricities, and the TOML file that holds them."""
