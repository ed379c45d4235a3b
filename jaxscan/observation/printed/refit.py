"""The stripe of one view, again, with the print of its board."""

import math

import numpy as np

from jaxscan.observation.prediction import SolvedRig, lift_to_board
from jaxscan.observation.printed.laser_light import fit_laser_light
from jaxscan.observation.printed.lattice import Lattice
from jaxscan.observation.printed.room_light import fit_room_light
from jaxscan.observation.printed.windows import Sight, cut_windows
from jaxscan.observation.stripes_on_board import EVEN, MOST_POINTS, STRONG, WEAK, FoundStripe


_MIN_LINES = 8
# Half width of a window, in widths of the stripe and in samples.
_WIDTHS, _MIN_HALF, _MAX_HALF = 3.2, 5, 16
# Part of the lines, at least, that the picture of the board must explain.
_LEAST_EXPLAINED = 0.7
# The model does not hold for a view with more blur than this [px].
_MOST_BLUR_PX = 1.5
# Share of the lines on which the stripe is clipped within so many widths of its centre, at most: flanks alone do not
# show the profile of a sheet, and other channels may see it whole.
_MOST_CLIPPED, _CORE = 0.2, 1.5
# The light within so many widths of the stripe must fall on the print.
_SURE = 2.5
# Chi-squared over the median from which a line does not follow the model, and the distance that a fit may move a
# centre [px]: such lines are left out.
_ODD_CHI2, _MOVED_PX = 4.0, 1.5
# Centres with a larger standard deviation are dropped [px].
_MAX_SIGMA_PX = 1.0
# Range of the print within 4 px, over that of paper and ink, from which an edge counts as weak, and as strong.
_WEAK, _STRONG = 0.1, 0.5


def fit_on_print(
    stripe: FoundStripe, keep: np.ndarray, sight: Sight, rig: SolvedRig, pose: np.ndarray
) -> FoundStripe | None:
    """The stripe of one view fitted through the print of its board.

    Args:
        keep: Lines on the board [lines].
        rig: A first solve, with the picture of its board.

    Returns:
        The stripe with new centres, sigmas and contrast, at most `MOST_POINTS` of them; None where the picture does
        not show the board, or there is too little of it.
    """
    picture, sites = rig.picture, sight.sites
    seen = (np.arange(len(keep)) - sites.first_line) % sites.line_step == 0
    line = np.flatnonzero(keep & stripe.valid & seen)
    if picture is None or len(line) < _MIN_LINES:
        return None
    if len(line) > MOST_POINTS:
        line = line[np.linspace(0, len(line) - 1, MOST_POINTS).round().astype(int)]
    raw = stripe.u[line].astype(np.float64)
    width = float(np.median(stripe.width[line]))
    half = int(np.clip(np.ceil((_WIDTHS * width + 1.5) / sites.pitch), _MIN_HALF, _MAX_HALF))
    windows, middle = cut_windows(sight, line, raw, half)
    core = np.abs(windows.place + middle[:, None] - raw[:, None]) < _CORE * width
    if np.mean((core & ~windows.used).any(1)) > _MOST_CLIPPED:
        return None
    slope = float(np.polyfit(line - line.mean(), raw, 1)[0])
    lattice = Lattice.around(half, sites.pitch, slope)
    x, y = _places(stripe, lattice, line, middle, lambda q: lift_to_board(rig, pose, q))
    paper = picture.at(x, y)
    room = fit_room_light(windows, paper, lattice)
    if room.exchanged:
        paper = np.float32(1.0) - paper
        room = fit_room_light(windows, paper, lattice)
    if room.explained.mean() < _LEAST_EXPLAINED:
        room = fit_room_light(windows, paper, lattice, far=True)
    if room.exchanged or room.explained.mean() < _LEAST_EXPLAINED or room.shared.blur >= math.log(_MOST_BLUR_PX):
        return None
    light = fit_laser_light(windows, paper, lattice, room, (raw - middle, width), sight.noise.speckle)
    u, sigma = middle + light.centre, np.hypot(light.sigma, light.doubt)
    near = np.searchsorted(lattice.across, [-_SURE * width, _SURE * width]).clip(0, len(lattice.across) - 1)
    sure = picture.holds(np.stack([x[near], y[near]], -1)).all((0, 2))
    good = sure & room.explained & (light.chi2 < _ODD_CHI2 * max(float(np.median(light.chi2)), 1.0))
    good &= (np.abs(u - raw) < _MOVED_PX) & (sigma < _MAX_SIGMA_PX)
    return _placed(stripe, line, good, (u, sigma, _contrast_class(light.contrast)))


def _contrast_class(contrast: np.ndarray) -> np.ndarray:
    return np.where(contrast < _WEAK, EVEN, np.where(contrast < _STRONG, WEAK, STRONG)).astype(np.int8)


def _placed(
    stripe: FoundStripe, line: np.ndarray, good: np.ndarray, found: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> FoundStripe:
    """The stripe with new values on some lines; the others become invalid."""
    u, sigma, contrast = (np.zeros(len(stripe.u), part.dtype) for part in found)
    valid = np.zeros(len(stripe.u), bool)
    u[line], sigma[line], contrast[line], valid[line] = *found, good
    return stripe._replace(u=u, sigma=sigma, valid=valid, contrast=contrast)


def _places(stripe: FoundStripe, lattice: Lattice, line: np.ndarray, middle: np.ndarray, lift) -> tuple:
    """Board coordinates x and y of the samples, float32 [k, lines, j]: by quadratics through three times three of them.

    Three samples in each direction span less than twenty pixels, over which lens and perspective bend by less than
    a hundredth of a pixel beside the quadratic.
    """
    along, across = lattice.along[-1] * np.arange(-1, 2), lattice.across[-1] * np.arange(-1, 2)
    nodes = np.stack(np.meshgrid(along, across, indexing="ij"), -1).reshape(-1, 2)
    u = middle[:, None] + lattice.slope * nodes[:, 0] + nodes[:, 1]
    v = line[:, None] + nodes[:, 0]
    q = np.stack([u, v] if stripe.stripe_axis == "rows" else [v, u], -1)
    xy = lift(q.reshape(-1, 2)).reshape(-1, 9, 2)
    down, over = _quadratic(lattice.along / along[-1]), _quadratic(lattice.across / across[-1])
    weights = np.einsum("ja,kb->abjk", down, over).reshape(9, -1)
    shape = len(line), len(lattice.along), len(lattice.across)
    # Single precision holds a thousandth of a pixel of a board of a metre.
    places = (np.asarray(xy[..., k] @ weights, np.float32).reshape(shape).transpose(2, 0, 1) for k in (0, 1))
    x, y = (np.ascontiguousarray(place) for place in places)
    return x, y


def _quadratic(t: np.ndarray) -> np.ndarray:
    """Weights of the values at -1, 0 and 1 [n, 3]."""
    return np.stack([0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)], -1)
