"""The simulated room: its surfaces, and its light."""
