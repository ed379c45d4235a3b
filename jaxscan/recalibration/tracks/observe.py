"""Features and targets in the laser-off images of sweeps, as tracks."""

from collections.abc import Sequence

from jaxscan.geometry import AbstractBoard, Scanner
from jaxscan.recalibration.observed import SweepStripes, Tracks
from jaxscan.recalibration.settings import RecalibrationSettings
from jaxscan.recalibration.tracks.seen import FeatureEyes, ImageSource


def observe_features(
    captures: Sequence[ImageSource],
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    eyes: FeatureEyes,
    settings: RecalibrationSettings,
    board: AbstractBoard | None = None,
) -> tuple[Tracks | None, tuple[str, ...]]:
    """Find targets, and follow features, through the laser-off images of sweeps.

    Args:
        captures: The sweeps' images; their angles are taken from `sweeps`.
        sweeps: The same sweeps' stripes, in the same order: names, angles, stations.
        scanner: The stored scanner, which predicts where features go.
        eyes: The functions that look at images: `api` has them from `vision`.
        settings: `features` and `marker_dictionary`.
        board: A board that was left standing.

    Returns:
        tracks: Points are in the frame of the first station; where other stations' poses are not known yet, those of
            features that they see are in their own frames: `place_tracks` moves them. None without any.
        notes: A sentence for each thing that a user should know.
    """
    raise NotImplementedError
