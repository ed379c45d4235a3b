"""Observations to a scanner."""
