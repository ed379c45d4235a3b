"""First values, before any iteration."""
