"""The laser-off images of a sweep as photographs of the room."""

from jaxscan.photographs.colour import BlendSettings, colour_points
from jaxscan.photographs.occluder import Occluder, make_occluder
from jaxscan.photographs.photograph import Photograph, Photographs, as_rgb
