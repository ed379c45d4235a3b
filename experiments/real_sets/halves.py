"""Solves twice from the observations of a calibration, from its even and from its odd views. Run by `compare`.

    python halves.py CALIBRATION.json OUTPUT     # writes OUTPUT.even.json and OUTPUT.odd.json

It is a program of its own, so that any version of jaxscan can be put on its path.
"""

import dataclasses
import sys

import equinox as eqx
import numpy as np

import jaxscan
from jaxscan.calibration import Calibration, CalibrationSettings, calibrate_camera
from jaxscan.observation import Observations


def part(whole: Observations, views: np.ndarray) -> Observations:
    """Observations of some views [k], in that order."""
    corners = whole.corners
    chosen = type(corners)(*(np.asarray(getattr(corners, one.name))[views] for one in dataclasses.fields(corners)))
    chosen = eqx.tree_at(lambda all_of: all_of.placement, chosen, np.arange(len(views), dtype=np.int32))
    row = np.full(len(np.asarray(corners.record)), -1)
    row[views] = np.arange(len(views))
    stripes = whole.stripes
    kept = row[np.asarray(stripes.view)] >= 0
    lines = type(stripes)(*(np.asarray(getattr(stripes, one.name))[kept] for one in dataclasses.fields(stripes)))
    lines = eqx.tree_at(lambda all_of: all_of.view, lines, row[np.asarray(lines.view)].astype(np.int32))
    return dataclasses.replace(whole, corners=chosen, stripes=lines)


def solve(observations: Observations, whole: Calibration, model: str) -> Calibration:
    """The largest part of the rig that the whole calibration holds."""
    settings = CalibrationSettings(camera=model)
    if whole.scanner is None:
        return calibrate_camera(observations, settings=settings)
    return jaxscan.calibrate_observations(observations, settings=settings)


def main() -> int:
    """Solve both halves."""
    source, output = sys.argv[1:3]
    whole = jaxscan.load_calibration(source)
    views = len(np.asarray(whole.observations.corners.record))
    for name, first in (("even", 0), ("odd", 1)):
        half = solve(part(whole.observations, np.arange(first, views, 2)), whole, whole.camera.model)
        jaxscan.save_calibration(half, f"{output}.{name}.json")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
