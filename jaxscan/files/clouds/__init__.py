"""Point clouds on disk."""
