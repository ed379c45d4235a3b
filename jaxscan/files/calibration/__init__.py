"""Calibrations on disk."""
