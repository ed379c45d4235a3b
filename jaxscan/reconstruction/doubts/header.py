"""Doubts about the header of a sweep: whether the frames show the mosaic, the colour and the axis that it names."""

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.doubts.seen import Seen
from jaxscan.reconstruction.sweep import SweepSource


_GREEN = {"bayer_rggb8": (1, 2), "bayer_bggr8": (1, 2), "bayer_grbg8": (0, 3), "bayer_gbrg8": (0, 3)}
_PHASES = {
    "bayer_rggb8": ("red", "green", "green", "blue"),
    "bayer_bggr8": ("blue", "green", "green", "red"),
    "bayer_grbg8": ("green", "red", "blue", "green"),
    "bayer_gbrg8": ("green", "blue", "red", "green"),
    "rgb8": ("red", "green", "blue"),
}
_LEAST_DN = 2.0
"""Level of a frame from which its mosaic can be seen [DN]."""


def header_doubts(sweep: SweepSource, seen: Seen, scanner: Scanner) -> list[str]:
    """Entries of the header that contradict the frames, or the calibrated rig."""
    doubts = _mosaic(sweep.pixel_format, np.median(seen.colours, 0)) if len(seen.colours) else []
    lit = np.bincount(sweep.record, minlength=len(sweep))
    for laser in np.unique(sweep.laser):
        line = sweep.lasers[laser]
        own = np.unique(sweep.record[sweep.laser == laser])
        own = own[lit[own] == 1]
        if len(own) and line.colour != "auto":
            doubts += _colour(sweep.pixel_format, line.colour, line.name, seen.light[own].sum(0))
    return doubts + _axis(sweep, scanner)


def _mosaic(pixel_format: str, colours: np.ndarray) -> list[str]:
    if pixel_format == "rgb8" or colours.mean() < _LEAST_DN:
        return []
    spread = np.ptp(colours) / colours.mean()
    if pixel_format == "mono8":
        if spread > 0.05:
            return ['the frames show a mosaic of colours, and pixel_format is "mono8"']
        return []
    if spread < 0.01:
        return [f'the frames show no mosaic of colours, and pixel_format is "{pixel_format}"']
    green = list(_GREEN[pixel_format])
    others = [k for k in range(4) if k not in green]
    unlike, alike = np.ptp(colours[green]), np.ptp(colours[others])
    if unlike > 4 * alike + 0.02 * colours.mean():
        return [f'the frames show another order of colours than the pixel_format "{pixel_format}"']
    return []


def _colour(pixel_format: str, colour: str, name: str, light: np.ndarray) -> list[str]:
    phases = _PHASES.get(pixel_format)
    if phases is None:
        return []
    shown = {one: float(np.mean([light[k] for k, two in enumerate(phases) if two == one])) for one in set(phases)}
    best = max(shown, key=lambda one: shown[one])
    if shown[best] > 2.5 * shown.get(colour, np.inf) and shown[best] > 0:
        return [f'the laser "{name}" is {best} in the frames, and {colour} or another order of colours in the header']
    return []


def _axis(sweep: SweepSource, scanner: Scanner) -> list[str]:
    """A sheet that is seen along the rows, with one centre asked for on each of them."""
    doubts = []
    normals = np.atleast_2d(np.asarray(scanner.lasers.normal, np.float64))
    upright = np.abs(normals[:, 0]) > 2 * np.abs(normals[:, 1])
    lying = np.abs(normals[:, 1]) > 2 * np.abs(normals[:, 0])
    axis = sweep.lasers[0].stripe_axis
    if (axis == "columns" and upright.all()) or (axis == "rows" and lying.all()):
        better = "rows" if axis == "columns" else "columns"
        doubts.append(f'stripe_axis is "{axis}", and the calibrated laser is seen across the {better}')
    return doubts
