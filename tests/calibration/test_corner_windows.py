"""Real pictures: what the window and the way of placing corners do to a calibration."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings, calibrate_camera
from jaxscan.geometry import Chessboard
from jaxscan.observation import BoardViews, Observations, StripeViews
from jaxscan.vision import find_corners


DATA = Path(__file__).parents[1] / "data"


def solve(pattern, board, **options):
    paths = sorted(DATA.glob(pattern))
    if not paths:
        pytest.skip(f"real data {pattern} are not here")
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
    found = [find_corners(image, board, **options) for image in images]
    count = len(found)
    nothing = np.zeros(0, np.int32)
    observations = Observations(
        board=board,
        corners=BoardViews(
            q=np.array([f.q for f in found]),
            sigma=np.array([f.sigma for f in found]),
            valid=np.array([f.valid for f in found]),
            angle=np.zeros(count),
            placement=np.zeros(count, np.int32),
            record=np.arange(count, dtype=np.int32),
        ),
        stripes=StripeViews(np.zeros((0, 64, 2)), np.zeros((0, 64)), np.zeros((0, 64), bool), nothing, nothing),
        width=images[0].shape[1],
        height=images[0].shape[0],
        laser_names=("laser",),
    )
    # The references assume true boards.
    settings = CalibrationSettings(judge=False)
    settings = replace(settings, free=tuple(block for block in settings.free if block != "shape"))
    return calibrate_camera(observations, settings=settings).quality, [path.stem for path in paths]


@pytest.mark.more
@pytest.mark.parametrize(
    ("pattern", "board", "most"),
    # cornerSubPix: 0.245, 0.170 and 0.174 px over all corners, outliers too.
    [
        ("ciclop/camera/*.jpg", Chessboard(6, 11, 0.013), 0.235),
        ("opencv_stereo_chess/left*.jpg", Chessboard(9, 6, 0.025), 0.155),
        # The left camera's sister, with the same board.
        pytest.param("opencv_stereo_chess/right*.jpg", Chessboard(9, 6, 0.025), 0.150, marks=pytest.mark.slow),
    ],
)
def test_fitted_corners_agree_better_than_gradient_ones(pattern, board, most):
    quality, names = solve(pattern, board)
    assert quality.corner_rms_all_px < most
    assert len(quality.per_view) == len(names)


def test_a_window_that_reaches_the_next_corner_is_told_by_its_view():
    """Half a window of 11 px is more than left02's smallest squares leave."""
    quality, names = solve("opencv_stereo_chess/left*.jpg", Chessboard(9, 6, 0.025), detector="classic", half_window=11)
    rms = np.array([view.corner_rms_px for view in quality.per_view])
    worst = int(np.argmax(rms))
    assert names[worst] == "left02"
    assert rms[worst] > 1.0 and rms[worst] > 5 * np.median(rms)
    # And it alone is named.
    named = [name for index, name in enumerate(names) if any(f"record {index}" in w for w in quality.warnings)]
    assert named == ["left02"]
