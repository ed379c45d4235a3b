"""Captures on disk, read."""
