"""What every file needs: bounded reading, whole writing, checked data."""
