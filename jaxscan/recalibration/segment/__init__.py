"""Sweeps to points on planes and spheres."""
