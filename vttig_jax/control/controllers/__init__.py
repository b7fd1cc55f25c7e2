"""Controllers that close the gap before a reversal."""
