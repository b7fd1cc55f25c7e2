"""Pictures of every object."""
