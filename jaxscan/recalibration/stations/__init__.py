"""First poses of stations, and clouds of several stations."""
