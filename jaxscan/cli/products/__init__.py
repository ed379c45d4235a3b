"""What is made of a scan beside its cloud: one file per verb."""
