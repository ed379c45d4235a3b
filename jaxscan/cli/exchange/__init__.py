"""Exchange with other programs: one file per verb."""
