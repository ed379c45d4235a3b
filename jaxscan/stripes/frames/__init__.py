"""What the arrays of a frame hold: pixel format, colour of the laser, noise, lamps that flicker."""
