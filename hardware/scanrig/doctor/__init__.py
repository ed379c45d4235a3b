"""The examination of a rig."""
