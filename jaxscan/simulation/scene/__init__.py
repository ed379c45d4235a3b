"""What stands in the simulated room, and how it is lit."""
