"""First contact of two toothed surfaces, with deviations and misalignment."""
