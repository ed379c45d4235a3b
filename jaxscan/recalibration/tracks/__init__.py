"""Features and targets in laser-off images: key images, prediction, triangulation, consistency with the turn."""

from jaxscan.recalibration.tracks.observe import observe_features
from jaxscan.recalibration.tracks.points import named_points, place_tracks
from jaxscan.recalibration.tracks.seen import Cylinder, FeatureEyes, Followed, FoundTargets, ImageSource, Walk
