"""Controllers: two that close the gap, their smooth versions, and a feedforward baseline."""
