"""Clouds from the vertices of a PLY file: on their grid, or as a single row of points."""

from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.ply import PROFILE, VERTEX
from jaxscan.files.clouds.stations import read_stations
from jaxscan.reconstruction import SMOOTHED, PointCloud


MAX_CELLS = 1 << 28
"""Largest accepted grid, 13 GB: 18 000 steps of two lasers on 7000 lines."""
SPARSE_CELLS = 1 << 24
"""Largest grid however few its points, 0.7 GB, where the file lists the profiles: 8000 steps on 2000 lines."""
SPARSE_CELLS_UNLISTED = 1 << 22
"""The same where it does not list them."""
CELLS_PER_POINT = 256
"""Of a larger grid with fewer points, the points are read alone."""


def organised(
    vertices: np.ndarray, per_profile: np.ndarray | None, comments: tuple[str, ...], path: Path, *, joined: bool
) -> PointCloud:
    """A cloud on the grid that the comments name; its points alone where the grid is far too large for them.

    Raises:
        CloudError: If grid, profiles, poses of stations, or numbers of points cannot be.
    """
    words = next((comment.split() for comment in comments if comment.startswith("grid ")), [])
    if len(words) != 3 or not all(word.isascii() and word.isdigit() and len(word) < 12 for word in words[1:]):
        raise CloudError(f'{path}: the comment "grid <profiles> <lines>" is missing or wrong.')
    profiles, lines = int(words[1]), int(words[2])
    if not 0 < profiles * lines <= MAX_CELLS:
        raise CloudError(
            f"{path}: found a grid of {profiles} x {lines}, none or more than the {MAX_CELLS} cells that a cloud can "
            "have; it is damaged."
        )
    step, row = vertices["step"], vertices["row"]
    if step.min() < 0 or step.max() >= profiles or row.min() < 0 or row.max() >= lines:
        raise CloudError(f"{path}: a point lies outside the grid of {profiles} x {lines}.")
    # "sigma" follows from the others and is not used.
    smoothed = [name for name in SMOOTHED if name in (vertices.dtype.names or ())]
    for name in (*(VERTEX.names or ()), *smoothed):
        if name != "sigma" and not np.isfinite(vertices[name]).all():
            raise CloudError(f"{path}: {name} of a point is not finite.")
    listed = per_profile is not None and len(per_profile) == profiles
    if profiles * lines > max(SPARSE_CELLS if listed else SPARSE_CELLS_UNLISTED, CELLS_PER_POINT * len(vertices)):
        # A few points ask for gigabytes.
        return unorganised(vertices, path, ours=True)
    valid = np.zeros((profiles, lines), bool)
    valid[step, row] = True
    if np.count_nonzero(valid) != len(vertices):
        raise CloudError(f"{path}: two points have the same step and row.")

    def spread(dtype: type, *names: str) -> np.ndarray:
        field: np.ndarray = np.zeros((profiles, lines, len(names)), dtype)
        for k, name in enumerate(names):
            field[step, row, k] = vertices[name]
        return field if len(names) > 1 else field[..., 0]

    if per_profile is not None and set(PROFILE.names or ()) <= set(per_profile.dtype.names or ()):
        if len(per_profile) != profiles or not np.isfinite(per_profile["angle"]).all():
            raise CloudError(f"{path}: found {len(per_profile)} profiles, expected {profiles} with finite angles.")
        angle = per_profile["angle"].astype(np.float64)
        record, laser = per_profile["record"].astype(np.int32), per_profile["laser"].astype(np.int32)
    else:
        angle, record, laser = np.zeros(profiles), np.arange(profiles, dtype=np.int32), np.zeros(profiles, np.int32)
        laser[step] = vertices["laser"]
    number = np.zeros(profiles, np.int32)
    if joined:
        number[step] = vertices["station"]
        # Profiles without a point have their station in this list alone.
        if per_profile is not None and listed and "station" in (per_profile.dtype.names or ()):
            number = per_profile["station"].astype(np.int32)
    return PointCloud(
        xyz=spread(_coordinates(vertices), "x", "y", "z"),
        rgb=spread(np.uint8, "red", "green", "blue"),
        intensity=spread(np.float32, "intensity"),
        normals=spread(np.float32, "nx", "ny", "nz"),
        sigma_random=spread(np.float32, "sigma_random"),
        sigma_systematic=spread(np.float32, "sigma_systematic"),
        valid=valid,
        record=record,
        laser=laser,
        angle=angle,
        **{name: spread(np.float32, name) for name in smoothed},
        stations=read_stations(comments, number, str(path)) if joined else None,
    )


def _coordinates(vertices: np.ndarray) -> type:
    """Type of the coordinates: a national grid needs the double that it came in."""
    return np.float32 if all(vertices.dtype[name].itemsize <= 4 for name in "xyz") else np.float64


def unorganised(vertices: np.ndarray, path: Path, *, ours: bool) -> PointCloud:
    """The points as a single profile; values that they lack are zero.

    Raises:
        CloudError: If no point is finite.
    """
    names = vertices.dtype.names or ()
    dtype = _coordinates(vertices)

    def column(*spellings: str) -> np.ndarray:
        for name in spellings:
            if name in names:
                # Values out of range become infinite, and are dropped below.
                with np.errstate(over="ignore"):
                    return vertices[name].astype(dtype)
        return np.zeros(len(vertices), dtype)

    xyz = np.stack([column(name) for name in "xyz"], -1)
    valid = np.isfinite(xyz).all(-1)
    if not valid.any():
        raise CloudError(f"{path}: holds no finite point.")
    normals = np.stack([column(name, f"normal_{name[1]}") for name in ("nx", "ny", "nz")], -1)
    # A part of a normal is another direction.
    whole = {"nx", "ny", "nz"} <= set(names) or {"normal_x", "normal_y", "normal_z"} <= set(names)
    with np.errstate(over="ignore"):
        lengths = np.sqrt((normals * normals).sum(-1, keepdims=True))
    usable = valid[:, None] & np.isfinite(lengths) & (lengths > 0) & whole
    # Without the grid nobody knows which points share their noise: each claims the sigma of its own row.
    own = "sigma_row" if {"sigma_row", "scalar_sigma_row"} & set(names) else "sigma_random"
    scalars = [column(name, f"scalar_{name}") for name in ("intensity", own, "sigma_systematic")]
    intensity, sigma_random, sigma_systematic = (np.where(valid & np.isfinite(one), one, 0) for one in scalars)
    shared = own == "sigma_random" and set(SMOOTHED) & set(names)
    if ours and (shared or not {"sigma_random", "sigma_systematic"} <= set(names)):
        # Ours have all. With one lost another would be taken for all of the uncertainty.
        sigma_random, sigma_systematic = np.zeros_like(sigma_random), np.zeros_like(sigma_systematic)
    return PointCloud(
        xyz=np.where(valid[:, None], xyz, 0)[None],
        rgb=np.where(valid[:, None], _colours(vertices), 0).astype(np.uint8)[None],
        intensity=intensity[None],
        normals=np.where(usable, normals / np.where(usable, lengths, 1), 0)[None],
        sigma_random=sigma_random[None],
        sigma_systematic=sigma_systematic[None],
        valid=valid[None],
        record=np.zeros(1, np.int32),
        laser=np.zeros(1, np.int32),
        angle=np.zeros(1),
    )


def _colours(vertices: np.ndarray) -> np.ndarray:
    names = vertices.dtype.names or ()
    if not {"red", "green", "blue"} <= set(names):
        return np.zeros((len(vertices), 3), np.uint8)
    colours = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    if colours.dtype == np.uint8:
        return colours
    if colours.dtype.kind == "f":
        return (np.clip(np.nan_to_num(colours), 0, 1) * 255 + 0.5).astype(np.uint8)
    return (colours >> 8 if colours.dtype.itemsize == 2 else np.clip(colours, 0, 255)).astype(np.uint8)
