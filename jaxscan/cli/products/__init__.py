"""What a scan is made from, and made into: one file per verb."""
