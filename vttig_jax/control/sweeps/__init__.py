"""Many cases in batches: a sweep, its folder and its table."""
