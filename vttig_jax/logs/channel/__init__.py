"""Processing of one encoder channel: wraps, spikes, stalls and speed."""
