"""From a stripe centre to a point: triangulated, turned, coloured, with its uncertainty."""
