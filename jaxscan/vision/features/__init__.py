"""Features and targets in laser-off images."""

from jaxscan.recalibration.tracks import FeatureEyes
from jaxscan.vision.features.follow import follow_features
from jaxscan.vision.features.targets import find_dictionary, find_targets
from jaxscan.vision.features.texture import enough_texture
from jaxscan.vision.frames import to_grey


def feature_eyes() -> FeatureEyes:
    """The functions of this room that look at laser-off images."""
    return FeatureEyes(to_grey, enough_texture, follow_features, find_dictionary, find_targets)
