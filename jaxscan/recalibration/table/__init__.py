"""Faults of the table's angles: wrong steps per turn, lost steps."""
