"""Recalibration from sweeps on the command line."""
