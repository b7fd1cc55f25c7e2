"""Plants: how the driven gear follows between both flanks."""
