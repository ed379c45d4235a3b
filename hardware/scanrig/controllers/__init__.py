"""Controllers: what turns the table, switches the laser and triggers the camera."""
