"""Captures on disk, written."""
