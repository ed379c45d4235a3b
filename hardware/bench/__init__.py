"""The rig on a desk: firmware in a simulator, a camera on loopback."""
