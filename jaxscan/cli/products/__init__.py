"""What is made of clouds: one file per verb."""
