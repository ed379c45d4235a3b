"""Calibrates from centres of circles that OpenCV finds: for a board that jaxscan has no finder for.

    python given_corners.py CAPTURE OUTPUT.json SUMMARY.json

The capture gives the grid as a chessboard. A symmetric grid looks the same when it is turned; every view has a pose of
its own, so that this does not matter. It is a program of its own, as `halves` is.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

import jaxscan
from jaxscan.errors import JaxscanError
from jaxscan.files.calibration import quality_table
from jaxscan.geometry import AbstractBoard
from jaxscan.observation import Eyes, FoundCorners, look_at_boards, to_observations
from jaxscan.report import words
from jaxscan.vision import to_grey


SIGMA_PX = 0.05
"""Standard deviation that is promised for a centre; the solve estimates the noise itself."""


def find(image: np.ndarray, board: AbstractBoard) -> FoundCorners | None:
    """The centres of a symmetric grid."""
    found, q = cv2.findCirclesGrid(image, board.grid())
    count = len(board.corners())
    if not found:
        return None
    return FoundCorners(q.reshape(-1, 2).astype(np.float64), np.full(count, SIGMA_PX), np.ones(count, bool))


def main() -> int:
    """Calibrate, and write what `jaxscan calibrate` says first."""
    capture = jaxscan.open_capture(sys.argv[1])
    board = capture.header.board.board()
    seen = look_at_boards([capture], board, Eyes(to_grey, find))
    try:
        result = jaxscan.calibrate_observations(to_observations([capture], seen))
    except JaxscanError as problem:
        print(f"jaxscan: {problem}", file=sys.stderr)
        return 1
    jaxscan.save_calibration(result, sys.argv[2])
    told = {"quality": quality_table(result.quality), "verdict": words.headline(result)._asdict()}
    Path(sys.argv[3]).write_text(json.dumps(told))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
