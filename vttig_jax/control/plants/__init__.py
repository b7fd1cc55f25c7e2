"""Plants: motion of the driven shaft between both flanks."""
