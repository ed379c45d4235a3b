"""Where on a line the stripe may be: the highest maxima of matched filters."""
