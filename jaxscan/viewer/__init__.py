"""Clouds in a browser: levels of detail, colours, sections, and measurements by a click."""

from jaxscan.viewer.shown import knows_its_place
from jaxscan.viewer.site import Named, Panorama, View, serve_clouds, view_routes
