"""One tooth: the flank and fillet that the rack cuts, and where they end."""
