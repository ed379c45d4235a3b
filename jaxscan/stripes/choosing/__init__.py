"""Which of the candidates of a line is the stripe."""
