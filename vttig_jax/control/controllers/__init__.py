"""Controllers: two close the gap, two are their smooth versions, one is a feedforward baseline."""
