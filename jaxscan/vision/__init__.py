"""OpenCV, and nothing else's."""
