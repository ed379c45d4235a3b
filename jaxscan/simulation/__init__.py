"""A known world to frames."""
