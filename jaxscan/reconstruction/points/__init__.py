"""From a stripe centre to a point: triangulated, turned, coloured, with its uncertainty."""

from jaxscan.reconstruction.points.colour import colours_at, stripe_colours
from jaxscan.reconstruction.points.gate import line_gate
from jaxscan.reconstruction.points.locate import Aim, Centres, Points, Rig, line_step, points_alone
from jaxscan.reconstruction.points.normals import grid_normals
from jaxscan.reconstruction.points.triangulate import Limits, triangulate
