"""The process of the command line: signals, errors, and the terminal."""
