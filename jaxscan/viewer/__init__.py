"""Clouds in a browser: levels of detail, colours, sections, and measurements by a click."""

from jaxscan.viewer.serve import Named, serve_clouds
