"""One joint least squares of scanner, stations, surfaces, features and boards."""
