"""The loops over points that are looked up in a photograph: colour and weight of each, and their blend.

Most points are done with before their colour is read: outside, seen from behind, or hidden.
"""

from typing import no_type_check

import numba
import numpy as np


STEEPEST_SEEN = 6.0
"""Ways along a surface for one across it, seen from the camera: beyond, no colour is taken."""
UNKNOWN_FACING = 0.5
"""Cosine to the line of sight that a surface without normal is taken to have."""
SKIN = 0.012
"""Depth, relative to the distance, by which a point may lie behind the surface without being hidden."""
FEATHER = 0.15
"""Share of the image, on each side, over which the weight rises from its border."""
SATURATED = 254
"""From this code on a pixel says nothing about the colour."""
MOST_WEIGHT = 1.0

_part = numba.njit(nogil=True)
_inlined = numba.njit(nogil=True, inline="always")
# Only what is called from outside is kept on disk: functions that are kept one by one are not inlined into each other.
_whole = numba.njit(nogil=True, cache=True)


@_inlined
@no_type_check
def _cubic(t):
    t2, t3 = t * t, t * t * t
    first, second = -0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3
    return first, second, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3


@_part
@no_type_check
def _read(image, u, v, colour):
    """Fill in the colour at a place by cubic convolution; the brightest code that it is made of."""
    rows, columns, _ = image.shape
    left, top = int(np.floor(u)), int(np.floor(v))
    across, down = _cubic(u - left), _cubic(v - top)
    brightest = 0
    for k in range(3):
        total, low, high = 0.0, 255, 0
        for i in range(4):
            row, along = min(max(top - 1 + i, 0), rows - 1), 0.0
            for j in range(4):
                level = image[row, min(max(left - 1 + j, 0), columns - 1), k]
                along += across[j] * level
                low, high = min(low, level), max(high, level)
            total += down[i] * along
        # No darker and no brighter than what it is made of: beside an edge the cubic would be.
        colour[k] = min(max(total, low), high)
        brightest = max(brightest, high)
    return brightest


@_inlined
@no_type_check
def _rise(place, size):
    """From 0 at both ends of an axis of the image to 1, smoothly."""
    t = min(max(min(place, size - 1 - place) / (FEATHER * size), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@_inlined
@no_type_check
def _is_hidden(distances, u, v, away, cosine):
    """Whether something stands before a point, or so near its line of sight that their light could mix."""
    nearest, cell, per_pixel = distances
    row, column = int(np.floor((v + 0.5) / cell)) + 1, int(np.floor((u + 0.5) / cell)) + 1
    row, column = min(max(row, 0), nearest.shape[0] - 1), min(max(column, 0), nearest.shape[1] - 1)
    # A slanted surface is nearer beside the point: within two cells by so much.
    cosine = min(max(cosine, 1.0 / STEEPEST_SEEN), 1.0)
    slope = np.sqrt(1.0 - cosine * cosine) / cosine
    return away * (1.0 - SKIN - 2.0 * cell * per_pixel * slope) > nearest[row, column]


@_whole
@no_type_check
def observe(image, places, sights, pose, rules, found):
    """Colour [DN] and weight of points in a photograph: at most 1, and 0 where it shows something else.

    Args:
        image: uint8 [rows, columns, 3].
        places: Points [n, 3] and their unit normals, zero where unknown.
        sights: Pixel [n, 2], distance from the camera [n] and whether it is in the image [n].
        pose: T_scanner_cam.
        rules: Nearest surface [rows, columns of cells], side of a cell, angle of a pixel; width of the bearing.
        found: Colour [n, 3] and weight [n], to be filled.
    """
    rows, columns, _ = image.shape
    (points, normals), (pixels, ranges, inside), (nearest, cell, per_pixel, bearing), (colours, weights) = (
        places,
        sights,
        rules,
        found,
    )
    for n in range(len(points)):
        weights[n] = 0.0
        if not inside[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        a, b, c = normals[n, 0], normals[n, 1], normals[n, 2]
        cosine = UNKNOWN_FACING
        if a != 0.0 or b != 0.0 or c != 0.0:
            cosine = (a * (pose[0, 3] - x) + b * (pose[1, 3] - y) + c * (pose[2, 3] - z)) / ranges[n]
        if cosine <= 1.0 / STEEPEST_SEEN:
            continue
        u, v = pixels[n, 0], pixels[n, 1]
        if _is_hidden((nearest, cell, per_pixel), u, v, ranges[n], cosine):
            continue
        if _read(image, u, v, colours[n]) >= SATURATED:
            continue
        # Resolution on the surface, in both directions of the image; next to that, the distance from the middle of the
        # rig changes little.
        away = min(np.sqrt(x * x + y * y + z * z) / max(ranges[n], 1e-3), 2.0)
        weight = min(cosine, 1.0) * away * away * min(_rise(u, columns), _rise(v, rows))
        if bearing < np.inf:
            cross, dot = pose[0, 2] * y - pose[1, 2] * x, pose[0, 2] * x + pose[1, 2] * y
            weight *= np.exp(-0.5 * (np.arctan2(cross, dot) / bearing) ** 2)
        weights[n] = min(weight, MOST_WEIGHT)


@_whole
@no_type_check
def add(found, gain, tolerance, tally):
    """One more observation of each point.

    Args:
        found: Colour [n, 3] and weight [n]; 0 for none.
        gain: Of the photograph, for each colour.
        tolerance: Difference [DN] up to which colours are the same.
        tally: Sums of weighted colours [n, room, 3], and of weights [n, room]; changed.
    """
    (colours, weights), (totals, sums) = found, tally
    room = sums.shape[1]
    for n in range(len(weights)):
        weight = weights[n]
        if weight <= 0.0:
            continue
        nearest, lightest, least = 0, 0, np.inf
        for slot in range(room):
            if sums[n, slot] < sums[n, lightest]:
                lightest = slot
            if sums[n, slot] > 0.0:
                apart = 0.0
                for k in range(3):
                    mean = totals[n, slot, k] / sums[n, slot]
                    apart = max(apart, abs(mean - colours[n, k] * gain[k]))
                if apart < least:
                    nearest, least = slot, apart
        slot = nearest
        if least > tolerance:
            # Where all colours are taken, the lightest gives way to a heavier one.
            if weight <= sums[n, lightest]:
                continue
            slot = lightest
            sums[n, slot] = 0.0
            for k in range(3):
                totals[n, slot, k] = 0.0
        sums[n, slot] += weight
        for k in range(3):
            totals[n, slot, k] += weight * colours[n, k] * gain[k]


@_whole
@no_type_check
def read(image, pixels, colours):
    """Colours [n, 3] of an image at places [n, 2], to be filled."""
    for n in range(len(pixels)):
        _read(image, pixels[n, 0], pixels[n, 1], colours[n])


@_whole
@no_type_check
def draw(sights, cell, nearest):
    """Draw samples of a surface as distances into cells.

    Args:
        sights: Pixel [n, 2], distance from the camera [n] and whether it is in the image [n].
        cell: Side of a cell [px].
        nearest: Of the surface in each cell, with a border of one; lowered where a sample is nearer.
    """
    pixels, ranges, inside = sights
    for n in range(len(ranges)):
        if inside[n]:
            # Each sample covers the two cells beside it on each axis, of which this is the first one.
            row = int(np.floor((pixels[n, 1] + 0.5) / cell - 0.5)) + 1
            column = int(np.floor((pixels[n, 0] + 0.5) / cell - 0.5)) + 1
            nearest[row, column] = min(nearest[row, column], ranges[n])
