"""A camera, a line laser and a turntable as a precise 3D scanner for rooms."""
