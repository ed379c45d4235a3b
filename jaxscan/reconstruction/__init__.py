"""Stripes to a coloured cloud."""
