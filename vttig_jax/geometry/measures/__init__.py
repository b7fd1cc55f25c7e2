"""What a shop measures on one gear: thickness, span, measure over balls."""
