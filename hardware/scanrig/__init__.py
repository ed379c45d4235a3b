"""The acquisition layer's host side: drives turntable, laser and camera, and writes captures."""
