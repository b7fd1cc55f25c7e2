"""Orders that the log shows beside the listed ones: higher whole orders, and lines."""
