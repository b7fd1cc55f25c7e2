"""Time stamps: dates, times of day, and numbers since an epoch."""
