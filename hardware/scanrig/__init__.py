"""The host's side of the rig: drives turntable, lasers and camera, and writes captures."""
