"""From a stripe centre to a point: triangulated, turned, coloured, with its uncertainty."""

from jaxscan.reconstruction.points.colour import colours_at, stripe_colours
from jaxscan.reconstruction.points.gate import line_gate
from jaxscan.reconstruction.points.locate import Aim, Centres, Limits, Points, line_step, points_alone, triangulate
from jaxscan.reconstruction.points.normals import grid_normals
