"""Targets in images of rooms: corners of printed markers, and of a board that was left standing."""

import functools
from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, known_dictionary
from jaxscan.recalibration.tracks import FoundTargets
from jaxscan.vision.boards import find_corners


USUAL = ("DICT_APRILTAG_36h11", "DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250")
"""Dictionaries that are tried where none is named; smaller ones have the same first markers."""
_SIGMA_PX = 0.05
"""Noise of a marker's corner [px]; the differences between images tell it better."""
_LEAST_SIDE = 32
_REFINED_PX = 4
_EDGE_PX, _ACROSS, _EDGE_SAMPLES = 4.0, 17, 24
"""Reach across an edge [px], and places across and along it at which the image is sampled."""
_LARGEST_PX = 1400
"""Side of the images in which dictionaries are looked for, at most."""
_SURE = 2
"""Images that must show a dictionary's markers before it is accepted: many textures look like a marker once."""


def find_dictionary(images: Sequence[np.ndarray]) -> str | None:
    """The dictionary of the markers in some images of a room; None where there are none."""
    seen: Counter[tuple[str, int]] = Counter()
    for image in images:
        if min(image.shape) < _LEAST_SIDE:
            continue
        scale = min(1.0, _LARGEST_PX / max(image.shape))
        shown = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
        _, ids, _, families = _detector(USUAL).detectMarkersMultiDict(np.ascontiguousarray(shown))
        if ids is not None:
            seen.update({(USUAL[int(k)], int(i)) for k, i in zip(np.ravel(families), np.ravel(ids), strict=True)})
    sure = Counter(name for (name, _), count in seen.items() if count >= _SURE)
    return sure.most_common(1)[0][0] if sure else None


def find_targets(image: np.ndarray, board: AbstractBoard | None, dictionary: str | None) -> FoundTargets:
    """Find the corners of targets in one image; a marker that is seen twice is returned twice.

    Args:
        image: Grey, uint8 [rows, columns].
        board: A board that was left standing.
        dictionary: OpenCV's name of the markers' dictionary; None: no markers are looked for.

    Returns:
        "marker 7 corner 2" (corners clockwise from the top left one) and "board corner 31".

    Raises:
        ValueError: If the dictionary is unknown.
    """
    names: list[str] = []
    places, sigmas = [np.zeros((0, 2))], [np.zeros(0)]
    image = np.ascontiguousarray(image)
    if dictionary is not None and min(image.shape) >= _LEAST_SIDE:
        corners, ids, _ = _detector((known_dictionary(dictionary),)).detectMarkers(image)
        numbers = [] if ids is None else [int(i) for i in np.ravel(ids)]
        for number, four in zip(numbers, corners, strict=True):
            if number in _own(board, dictionary):
                continue
            names += [f"marker {number} corner {corner}" for corner in range(4)]
            places.append(_by_edges(image, np.reshape(four, (4, 2)).astype(np.float64)))
            sigmas.append(np.full(4, _SIGMA_PX))
    if board is not None and _may_show(image, board):
        found = find_corners(image, board)
        if found is not None:
            index = np.flatnonzero(found.valid)
            names += [f"board corner {k}" for k in index]
            places.append(found.q[index])
            sigmas.append(found.sigma[index])
    return FoundTargets(tuple(names), np.concatenate(places), np.concatenate(sigmas))


def _by_edges(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners of a marker where the lines of its edges meet: the gradient at a corner itself lies inwards of it."""
    following = np.roll(corners, -1, 0)
    along = following - corners
    length = np.linalg.norm(along, axis=1)
    if length.min() < 4 * _EDGE_PX:
        return corners
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / length[:, None]
    # Clear of the corners, where the next edge is near.
    clear = np.minimum(1.5 * _EDGE_PX / length, 0.35)[:, None]
    share = clear + (1 - 2 * clear) * np.linspace(0, 1, _EDGE_SAMPLES)
    r = np.linspace(-_EDGE_PX, _EDGE_PX, _ACROSS)
    point = corners[:, None] + share[..., None] * along[:, None]
    at = (point[:, :, None] + r[:, None] * normal[:, None, None]).astype(np.float32).reshape(-1, _ACROSS, 2)
    level = np.asarray(cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR), np.float64)
    slope = np.maximum(np.diff(level, axis=1) * _outwards(corners), 0.0)
    middle = (slope * (r[1:] + r[:-1]) / 2).sum(1) / np.maximum(slope.sum(1), 1e-9)
    # The lens bends the lines: parabolas, and at a corner their tangents.
    bends = [np.polyfit(s, m, 2) for s, m in zip(share, middle.reshape(4, -1), strict=True)]

    def tangent(k: int, place: float) -> tuple[np.ndarray, np.ndarray]:
        way = along[k] + np.polyval(np.polyder(bends[k]), place) * normal[k]
        return corners[k] + place * along[k] + np.polyval(bends[k], place) * normal[k], way

    refined = np.array([_meeting(tangent(k - 1, 1.0), tangent(k, 0.0)) for k in range(4)])
    return np.where(np.abs(refined - corners).max() < _EDGE_PX, refined, corners)


def _outwards(corners: np.ndarray) -> float:
    """1 where the normals of the edges point out of the marker, else -1."""
    x, y = (corners - corners.mean(0)).T
    area = float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    return -1.0 if area > 0 else 1.0


def _meeting(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The point where two lines meet, each a point and a direction."""
    t, _ = np.linalg.solve(np.stack([first[1], -second[1]], -1), second[0] - first[0])
    return np.asarray(first[0] + t * first[1])


def _may_show(image: np.ndarray, board: AbstractBoard) -> bool:
    """Whether a board may be in the image: the search for a chessboard that is not there takes seconds."""
    if not isinstance(board, Chessboard) or isinstance(board, Charuco):
        return True
    return min(image.shape) >= _LEAST_SIDE and bool(cv2.checkChessboard(image, board.grid()))


def _own(board: AbstractBoard | None, dictionary: str) -> range:
    """Numbers of the markers that are parts of the board."""
    if isinstance(board, Charuco) and board.dictionary.split("_")[1] == dictionary.split("_")[1]:
        return range(board.columns * board.rows // 2)
    if isinstance(board, AprilGrid) and dictionary.upper() == "DICT_APRILTAG_36H11":
        return range(board.columns * board.rows)
    return range(0)


@functools.cache
def _detector(names: tuple[str, ...]) -> "cv2.aruco.ArucoDetector":
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = _REFINED_PX
    dictionaries = [cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)) for name in names]
    return cv2.aruco.ArucoDetector(dictionaries, settings)
