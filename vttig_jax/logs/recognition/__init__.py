"""Recognition of the columns of a log from their names and from the given ratio."""
