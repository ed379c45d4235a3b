"""A cloud to numbers."""
