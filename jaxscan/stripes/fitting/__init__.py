"""The centre of each candidate, fitted and judged."""
