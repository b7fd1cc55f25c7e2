"""Workshop measures of one gear: tooth thickness, span and measurement over balls."""
