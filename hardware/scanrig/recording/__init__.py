"""What a session leaves on the disk."""
