"""Chessboard corners to thousandths of a pixel: a model of two crossing edges is fitted to the image."""

from typing import NamedTuple

import numpy as np

from jaxscan.observation import FoundCorners


# Smallest and largest half side of the window [px]: fewer pixels do not hold the nine unknowns, and
# farther out edges are bent by more than a curvature.
_MIN_HALF, _MAX_HALF = 4, 10
_UNKNOWNS = 9
_STEPS = 15
# A fit has converged when a step moves the corner by less than this [px].
_SETTLED = 1e-3
# Residuals larger than this share of the contrast between ink and paper: the place is no chessboard corner.
_MAX_MISFIT = 0.25
# The same holds for residuals this many times the median of the image, and for a lower contrast.
_ODD = 3.0
_MIN_CONTRAST_DN = 2.0
# For images of more than 8 bits, whose noise is larger than their rounding.
_MIN_FINE_DN = 0.2
# The edges must cross at this angle at least, and stay within this angle of their first directions [rad].
_MIN_CROSSING = 0.25
_MAX_TURN = 0.35
# Smallest share of the window that must lie inside the image.
_MIN_SEEN = 0.6
# An image of whole numbers has no less noise than this [DN].
_QUANTISED_DN = 0.3
# Side of the blocks [px] that show whether neighbours share their errors, the number of corners that
# are looked at for that, and the largest factor by which the variance is raised: in pictures of webcams,
# compressed and sharpened, it is 2 to 8, and corners scatter by that; in raw frames it is 1.
_BLOCK = 3
_SAMPLE = 16
_MOST_SHARED = 8.0
# Error of the model itself [px]: bent edges, quantised images.
_FLOOR_PX = 2e-3


def fit_corners(
    image: np.ndarray,
    start: np.ndarray,
    edges: np.ndarray,
    half: np.ndarray,
    *,
    clear: np.ndarray | None = None,
    bend: np.ndarray | None = None,
) -> FoundCorners:
    r"""Chessboard corners by a least-squares fit of two blurred crossing edges.

    $$I(q) = \Bigl[l + c\, \mathrm{erf}\frac{d_1(q)}{\sqrt2 w}\, \mathrm{erf}\frac{d_2(q)}{\sqrt2 w}\Bigr]
      \,\bigl(1 + g \cdot (q - q_0)\bigr)$$

    with $d_k$ the distance from edge $k$: nine unknowns a corner (centre, two directions, level,
    contrast, blur, gradient of the light), all corners at once by damped Gauss-Newton. Effects
    that the model leaves out (swollen ink, a bent grey scale, unequal blur, the rounded crossing)
    are the same on opposite sides of a corner and do not move it.

    Args:
        image: uint8, or float in DN of 8 bits [rows, columns].
        start: First values [corners, 2], px.
        edges: Unit vectors along the two edges [corners, 2 (edge), 2 (u, v)].
        half: Half the window's side [corners], px; taken as 4 ... 10. The window must not reach
            the next corner.
        clear: Pixels farther than this from both edges are left out [corners], px, because of
            markers. None: all count.
        bend: Curvature of the two edges in the image [corners, 2], 1 / px, positive where an edge along u bends
            towards v. Fitted as straight, edges would move a corner by a sixth of it times the square of `half`.
            None: straight.

    Returns:
        The corners; not valid where the model does not fit or the fit diverged.

    Source: Geiger et al., Automatic camera and range sensor calibration using a single shot
    (2012), for edges of a chessboard as a model; Newey and West (1987) for covariance when
    neighbours share their errors.
    """
    if len(start) == 0:
        return FoundCorners(np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool))
    half = np.clip(np.floor(half), _MIN_HALF, _MAX_HALF)
    start, angle = np.asarray(start, np.float64), np.arctan2(edges[..., 1], edges[..., 0])
    window = _cut(image, start, half, angle, clear)
    if bend is not None:
        window = _straightened(window, angle, bend)
    least = _MIN_CONTRAST_DN if image.dtype == np.uint8 else _MIN_FINE_DN
    return _judged(window, _fit(window, _start(window, angle)), start, angle, half, least)


class _Window(NamedTuple):
    """Pixels around the corners, windows flattened: float32 [corners, pixels], for speed."""

    level: np.ndarray
    u: np.ndarray
    """Coordinate u, counted from the first value of the corner [px]."""
    v: np.ndarray
    weight: np.ndarray
    """1 where the pixel counts, else 0."""
    seen: np.ndarray
    """Share of the window that lies inside the image [corners]."""
    side: int


class _Fit(NamedTuple):
    """The state of all fits; unknowns are x, y, two angles, level, contrast, blur, gradient (2)."""

    unknowns: np.ndarray
    residual: np.ndarray
    """[corners, pixels]."""
    jacobian: np.ndarray
    """[corners, 9, pixels]."""


def _cut(
    image: np.ndarray, start: np.ndarray, half: np.ndarray, angle: np.ndarray, clear: np.ndarray | None
) -> _Window:
    reach = int(half.max())
    offset = np.arange(-reach, reach + 1)
    first = np.rint(start).astype(int)
    columns, rows = first[:, :1] + offset, first[:, 1:] + offset
    height, width = image.shape
    wanted = np.abs(offset) <= half[:, None]
    inside = [wanted & (at >= 0) & (at < size) for at, size in ((columns, width), (rows, height))]
    seen = np.prod([part.sum(1) / wanted.sum(1) for part in inside], axis=0)
    level = image[np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :]]
    flat = (len(start), -1)
    u = np.broadcast_to((columns - start[:, :1])[:, None, :], level.shape).reshape(flat)
    v = np.broadcast_to((rows - start[:, 1:])[:, :, None], level.shape).reshape(flat)
    weight = (inside[1][:, :, None] & inside[0][:, None, :]).reshape(flat)
    if clear is not None:
        weight = weight & (np.abs(_across(angle, u, v)).min(0) <= np.asarray(clear)[:, None])
    level, u, v, weight = (part.reshape(flat).astype(np.float32) for part in (level, u, v, weight))
    return _Window(level, u, v, weight, seen, len(offset))


def _straightened(window: _Window, angle: np.ndarray, bend: np.ndarray) -> _Window:
    """The window with its pixels moved so that edges of these curvatures [1 / px] are straight."""
    sine, cosine = np.sin(angle).T[..., None], np.cos(angle).T[..., None]
    along = cosine * window.u + sine * window.v
    first, second = -0.5 * bend.T[..., None] * along**2
    # The shift that changes the distance from the first edge, and that from the second, by this much.
    turn = cosine[0] * sine[1] - sine[0] * cosine[1]
    turn = np.where(np.abs(turn) < np.sin(_MIN_CROSSING), np.inf, turn)
    u = window.u + (cosine[1] * first - cosine[0] * second) / turn
    v = window.v + (sine[1] * first - sine[0] * second) / turn
    return window._replace(u=u.astype(np.float32), v=v.astype(np.float32))


def _across(angle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Signed distance from both edges through the origin [2, corners, pixels]."""
    sine, cosine = np.sin(angle).T[..., None], np.cos(angle).T[..., None]
    return cosine * v - sine * u


def _start(window: _Window, angle: np.ndarray) -> np.ndarray:
    """First values; level and contrast by linear regression of the image on the expected pattern."""
    unknowns = np.zeros((len(angle), _UNKNOWNS))
    unknowns[:, 2:4], unknowns[:, 6] = angle, 1.0
    pattern = np.prod(_edge(_across(angle, window.u, window.v))[0], axis=0)
    total = np.maximum(window.weight.sum(1), 1.0)
    mean = lambda values: (window.weight * values).sum(1) / total
    middle, level = mean(pattern), mean(window.level)
    spread = np.maximum(mean(pattern**2) - middle**2, 1e-9)
    unknowns[:, 5] = (mean(pattern * window.level) - middle * level) / spread
    unknowns[:, 4] = level - unknowns[:, 5] * middle
    return unknowns


def _fit(window: _Window, unknowns: np.ndarray) -> _Fit:
    """Levenberg-Marquardt on all corners; those that have converged drop out."""
    fit = _Fit(unknowns, *_linearised(window, unknowns))
    damping = np.full(len(unknowns), 1e-3)
    active = np.arange(len(unknowns))
    for _ in range(_STEPS):
        jacobian, residual = fit.jacobian[active], fit.residual[active]
        normal = (jacobian @ jacobian.transpose(0, 2, 1)).astype(np.float64)
        slope = jacobian @ residual[..., None]
        damped = normal + np.eye(_UNKNOWNS) * (damping[active, None] * np.einsum("cii->ci", normal) + 1e-9)[:, None]
        step = -np.linalg.solve(damped, slope)[..., 0]
        # Far from the solution a full step may diverge.
        moved = np.hypot(step[:, 0], step[:, 1])
        step /= np.maximum(np.maximum(moved / 1.5, np.abs(step[:, 2:4]).max(1) / 0.3), 1.0)[:, None]
        trial = fit.unknowns[active] + step
        trial[:, 6] = np.clip(trial[:, 6], 0.15, 6.0)
        part = window._replace(**{name: getattr(window, name)[active] for name in ("level", "u", "v", "weight")})
        seen = _Fit(trial, *_linearised(part, trial))
        better = (seen.residual**2).sum(1) <= (residual**2).sum(1)
        chosen = active[better]
        for old, new in zip(fit, seen, strict=True):
            old[chosen] = new[better]
        damping[active] *= np.where(better, 0.1, 10.0)
        active = active[(moved > _SETTLED) & (damping[active] < 1e3)]
        if len(active) == 0:
            break
    return fit


def _linearised(window: _Window, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals [corners, pixels] and their Jacobian [corners, 9, pixels]."""
    unknowns = unknowns.astype(np.float32)
    x, y, first, second, level, contrast, width, slope_u, slope_v = (unknowns[:, k, None] for k in range(_UNKNOWNS))
    du, dv = window.u - x, window.v - y
    across = _across(unknowns[:, 2:4], du, dv)
    pattern, by_edge = _crossing(across / width, np.cos(first - second))
    light = window.weight * (1.0 + slope_u * window.u + slope_v * window.v)
    seen = level + contrast * pattern
    by = contrast * light / width * by_edge
    sine, cosine = np.sin((first, second)), np.cos((first, second))
    jacobian = np.empty((len(unknowns), _UNKNOWNS, window.u.shape[1]), np.float32)
    jacobian[:, 0] = sine[0] * by[0] + sine[1] * by[1]
    jacobian[:, 1] = -cosine[0] * by[0] - cosine[1] * by[1]
    jacobian[:, 2:4] = np.swapaxes(-(cosine * du + sine * dv) * by, 0, 1)
    jacobian[:, 4], jacobian[:, 5] = light, pattern * light
    jacobian[:, 6] = -(across[0] * by[0] + across[1] * by[1]) / width
    bright = window.weight * seen
    jacobian[:, 7], jacobian[:, 8] = bright * window.u, bright * window.v
    return seen * light - window.weight * window.level, jacobian


def _crossing(t: np.ndarray, overlap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Two crossing edges under a Gaussian blur, -1 ... 1, and the derivatives by their distances.

    The mean of the product of the signs of two normal variables, whose correlation $\rho$ =
    `overlap` is the cosine of the angle between the edges:

    $$\mathrm{erf}\,\mathrm{erf} + 4 \varphi(t_1) \varphi(t_2)
      \sum_{n \ge 1} \tfrac{\rho^n}{n!} He_{n-1}(t_1) He_{n-1}(t_2)$$
    """
    (e1, e2), (g1, g2) = _edge(t)
    a, b = t
    second, third = 0.5 * overlap**2, overlap**3 / 6.0
    a2, b2 = a * a - 1.0, b * b - 1.0
    both = g1 * g2
    series = overlap + second * a * b + third * a2 * b2
    by_a = g1 * e2 + both * (second * b + 2.0 * third * a * b2 - a * series)
    by_b = g2 * e1 + both * (second * a + 2.0 * third * b * a2 - b * series)
    return e1 * e2 + both * series, np.stack([by_a, by_b])


def _edge(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """erf(t / sqrt 2) to 2e-7, and its derivative. Source: Abramowitz and Stegun, 7.1.26."""
    bell = np.exp(-0.5 * t * t)
    z = 1.0 / (1.0 + 0.23164189 * np.abs(t))
    series = z * (0.254829592 + z * (-0.284496736 + z * (1.421413741 + z * (-1.453152027 + z * 1.061405429))))
    return np.copysign(1.0 - series * bell, t), 0.79788456 * bell


def _judged(
    window: _Window, fit: _Fit, start: np.ndarray, angle: np.ndarray, half: np.ndarray, least: float
) -> FoundCorners:
    unknowns, jacobian = fit.unknowns, fit.jacobian
    count = window.weight.sum(1)
    normal = (jacobian @ jacobian.transpose(0, 2, 1)).astype(np.float64)
    # Scaled for good conditioning, and damped so that windows outside the image give an invertible
    # matrix too; their corners are dropped below.
    scale = np.sqrt(np.maximum(np.einsum("cii->ci", normal), 1e-12))
    both = scale[:, :, None] * scale[:, None, :]
    inverse = np.linalg.inv(normal / both + 1e-6 * np.eye(_UNKNOWNS)) / both
    noise = np.sqrt((fit.residual**2).sum(1) / np.maximum(count - _UNKNOWNS, 1.0))
    contrast, blur = np.abs(unknowns[:, 5]), unknowns[:, 6]
    turned = np.abs((unknowns[:, 2:4] - angle + np.pi / 2) % np.pi - np.pi / 2).max(1)
    crossing = np.abs((unknowns[:, 2] - unknowns[:, 3] + np.pi / 2) % np.pi - np.pi / 2)
    moved = np.hypot(unknowns[:, 0], unknowns[:, 1])
    valid = (window.seen >= _MIN_SEEN) & (count > 3 * _UNKNOWNS) & np.isfinite(unknowns).all(1)
    valid &= (contrast >= least) & (noise <= _MAX_MISFIT * contrast)
    valid &= (turned <= _MAX_TURN) & (crossing >= _MIN_CROSSING) & (blur <= half / 2.5)
    valid &= moved <= np.maximum(half / 3.0, 1.0)
    if valid.any():
        valid &= noise <= _ODD * np.median(np.maximum(noise[valid], _QUANTISED_DN))
    plain = noise**2 * np.einsum("cii->ci", inverse)[:, :2].mean(1)
    sigma = np.sqrt(plain * _shared_noise(window, fit, inverse, valid) + _FLOOR_PX**2)
    return FoundCorners(np.where(valid[:, None], start + unknowns[:, :2], start), np.where(valid, sigma, 1.0), valid)


def _shared_noise(window: _Window, fit: _Fit, inverse: np.ndarray, valid: np.ndarray) -> float:
    """Ratio of the corners' variance to the variance that white noise would give."""
    some = np.flatnonzero(valid)
    if len(some) == 0:
        return 1.0
    some = some[:: -(-len(some) // _SAMPLE)]
    jacobian, residual, part = fit.jacobian[some], fit.residual[some], inverse[some]
    influence = part[:, :2] @ jacobian
    moved = _blocks(influence * residual[:, None], window.side)
    alone = _blocks(influence**2, window.side).sum(-1)
    # The nine unknowns have absorbed part of every block's noise.
    taken = _blocks((influence[:, :, None] * jacobian[:, None]).reshape(len(some), 2 * _UNKNOWNS, -1), window.side)
    taken = taken.reshape(len(some), 2, _UNKNOWNS, -1)
    lost = np.einsum("ckib,cij,ckjb->ck", taken, part, taken, optimize=True)
    noise = (residual**2).sum(1) / np.maximum(window.weight[some].sum(1) - _UNKNOWNS, 1.0)
    ratio = ((moved**2).sum(-1) / np.maximum(alone - lost, 0.1 * alone)).mean(1) / np.maximum(noise, 1e-12)
    return float(np.clip(np.minimum(ratio, 3.0 * np.median(ratio)).mean(), 1.0, _MOST_SHARED))


def _blocks(images: np.ndarray, side: int) -> np.ndarray:
    """Sums over blocks of 3 x 3 pixels [corners, images, blocks]."""
    count, depth = images.shape[:2]
    short = -side % _BLOCK
    images = np.pad(images.reshape(count, depth, side, side), ((0, 0), (0, 0), (0, short), (0, short)))
    blocks = images.shape[-1] // _BLOCK
    return images.reshape(count, depth, blocks, _BLOCK, blocks, _BLOCK).sum((3, 5)).reshape(count, depth, -1)
