"""Logs compressed to block rows and to summaries of both flanks."""
