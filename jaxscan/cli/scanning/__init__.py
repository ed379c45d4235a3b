"""The verbs that drive a rig."""
