"""One encoder channel: readings, wraps, spikes and stalls."""
