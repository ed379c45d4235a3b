r"""What sweeps added to the stored calibration, and which part of the rig moved, if any, since that was made.

Where nothing moved, the departure $d = s_1 - s_0$ of a joint solve from its prior has the covariance $C_0 - C_1$. In
the directions in which the data gained something that gives independent numbers $w$ of unit variance, and
$T = w^T w$ is chi-squared. A move $\delta$ of the rig beyond its prior shifts them to

$$E[w] = A \delta, \qquad A = (I - \Lambda)^{1/2} V^T L^{-1}$$

so which parts explain the departure is linear least squares: $T$ of the rest is chi-squared again, with as many
degrees of freedom less as the move has.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Lengths
from jaxscan.geometry import Scanner, Turntable, root_of, square_root
from jaxscan.leastsq import chance_of
from jaxscan.measurement.systematic import point_gradient
from jaxscan.recalibration.grid import spread_over
from jaxscan.recalibration.observed import RoomObservations
from jaxscan.recalibration.result import Adjusted, Drift, Gain, LengthGain, Moved
from jaxscan.recalibration.triangulate import triangulate_points


# A ratio of variances below this is rounding.
_ROUNDING = 1e-13


class Compared(NamedTuple):
    r"""A prior and a posterior covariance in the directions in which they differ one by one.

    With $C_0 = L L^T$ and $L^{-1} C_1 L^{-T} = V \Lambda V^T$, a step $L v_i$ was one standard deviation before and is
    $\sqrt{\lambda_i}$ after. Parameters that are held have no part in any direction.
    """

    prior: Float[np.ndarray, "params params"]
    posterior: Float[np.ndarray, "params params"]
    direction: Float[np.ndarray, "params directions"]
    """Steps of one standard deviation of the prior, as columns; best known after last."""
    whiten: Float[np.ndarray, "directions params"]
    """Takes a step to its part in each direction, in units of the prior's standard deviation."""
    ratio: Float[np.ndarray, " directions"]
    """Variance after over that before [1]."""

    @property
    def factor(self) -> Float[np.ndarray, " directions"]:
        """Old over new standard deviation of each direction [1]."""
        return 1.0 / np.sqrt(self.ratio)


def compare(prior: Float[np.ndarray, "params params"], posterior: Float[np.ndarray, "params params"]) -> Compared:
    """Two covariances [px, rad, m] by their generalised eigenvalues; a parameter without variance before is held."""
    prior, posterior = np.asarray(prior, np.float64), np.asarray(posterior, np.float64)
    root = square_root(prior)
    free = root.steps.any(1)
    steps, inverse = root.steps[free].T, root.inverse[:, free].T
    after = inverse @ posterior @ inverse.T
    ratio, turned = np.linalg.eigh((after + after.T) / 2.0)
    ratio, turned = ratio[::-1], turned[:, ::-1]
    return Compared(prior, posterior, steps @ turned, turned.T @ inverse, np.maximum(ratio, _ROUNDING))


def with_prior(
    loose: Compared, step: Float[np.ndarray, " params"], prior: Float[np.ndarray, "params params"]
) -> tuple[Compared, Float[np.ndarray, " params"]]:
    """A solve with a loose prior, and its step, as they would have come out with a tighter one, to first order.

    A scanner that moved beyond a tight prior would leave bent walls, which would be taken for noise. So the data speak
    by a solve that lets everything move.
    """
    information = np.maximum(1.0 / loose.ratio - 1.0, 0.0)
    gradient = (loose.whiten @ step) / loose.ratio
    root = root_of(loose.whiten @ np.asarray(prior, np.float64) @ loose.whiten.T).T
    inner = np.linalg.inv(np.eye(len(root)) + root.T @ (information[:, None] * root))
    posterior = loose.direction @ (root @ inner @ root.T) @ loose.direction.T
    return compare(prior, posterior), loose.direction @ (root @ (inner @ (root.T @ gradient)))


NAMES = ("radial scale", "height scale")
# More points add nothing.
_POINTS = 512


def scale_slopes(
    scanner: Scanner, observations: RoomObservations, corrections: tuple[Float[np.ndarray, " records"], ...] = ()
) -> Float[np.ndarray, "2 params"]:
    """Radial and height scale of a room by a step of the scanner that measures it [1 per px, rad, m]."""
    points = observations.points.take(spread_over(np.arange(len(observations.points.q)), _POINTS))
    where = points.q, points.laser, observations.angles_of(points, corrections)
    arm, valid = triangulate_points(scanner, *where)
    slope = point_gradient(scanner.rig, *where)
    if not isinstance(scanner.turntable, Turntable):
        raise TypeError(f"found {type(scanner.turntable).__name__}, expected a turntable")
    # The axis is the z axis of the scanner's frame.
    arm, slope = arm[valid], slope[valid]
    up = arm * np.array([0.0, 0.0, 1.0])
    turns = [np.cross(unit, arm) for unit in np.eye(3)]
    shifts = [np.broadcast_to(unit, arm.shape) for unit in np.eye(3)]
    fields = np.stack([field.ravel() for field in (arm - up, up, *shifts, *turns)], axis=-1)
    return np.linalg.pinv(fields)[:2] @ slope.reshape(len(fields), -1)


# A direction whose gain is below this counts as held by the stored calibration alone.
_OBSERVED = 2.0
# A direction that lies so far within the space of the scales is not named by itself.
_SAME = 0.8
# Components of a direction that are named: at most so many, and none much smaller than the largest.
_NAMED, _SHARE = 3, 0.4


class Scales(NamedTuple):
    """Radial and height scale by a step of the scanner, and how far they are known."""

    before: Float[np.ndarray, "2"]
    after: Float[np.ndarray, "2"]
    factor: Float[np.ndarray, "2"]
    """Old over new standard deviation along the steps of the scanner that are left for each scale [1]; 1 where the
    captures say nothing of it, even if `before` is larger because of other parameters."""
    left: Float[np.ndarray, "params 2"]
    """The steps that are left for each scale; each is one standard deviation after the sweeps."""


def scales_of(compared: Compared, slope: Float[np.ndarray, "2 params"]) -> Scales:
    """How far the two scales are known before and after."""
    before, after = (np.sqrt(np.einsum("si,ij,sj->s", slope, c, slope)) for c in (compared.prior, compared.posterior))
    left = compared.posterior @ slope.T / np.where(after > 0, after, 1.0)
    along = compared.whiten @ left
    old = np.sum(along**2, axis=0)
    new = np.sum(along**2 / compared.ratio[:, None], axis=0)
    return Scales(before, after, np.sqrt(new / np.where(old > 0, old, 1.0)), left)


def gains_of(compared: Compared, scales: Scales, names: tuple[str, ...]) -> tuple[Gain, ...]:
    """Radial and height scale in ppm, then all directions, best known last."""
    found = [
        Gain(name, 1e6 * float(old), 1e6 * float(new), "ppm")
        for name, old, new in zip(NAMES, scales.before, scales.after, strict=True)
    ]
    order = np.argsort(compared.factor, kind="stable")
    directions = [Gain(_named(compared, i, names), 1.0, float(1.0 / compared.factor[i])) for i in order]
    return (*found, *directions)


def unobserved(compared: Compared, scales: Scales, names: tuple[str, ...]) -> tuple[str, ...]:
    """Sentences on the directions that the stored calibration alone holds: the scales, then all others."""
    seen = scales.factor >= _OBSERVED
    told = [
        f"{name}: {_ALIKE[name]}; {_holding(old, new)}"
        for name, old, new, good in zip(NAMES, scales.before, scales.after, seen, strict=True)
        if not good
    ]
    left, _ = np.linalg.qr(compared.whiten @ scales.left[:, ~seen])
    order = np.argsort(compared.factor, kind="stable")
    others = [i for i in order if compared.factor[i] < _OBSERVED and np.sum(left[i] ** 2) < _SAME]
    if others:
        some, more = others[:_NAMED_AT_MOST], " and others" if len(others) > _NAMED_AT_MOST else ""
        named = "; ".join(_named(compared, i, names) for i in some)
        told.append(
            f"{len(others)} directions are known less than twice as well as before ({named}{more}): the stored "
            "calibration holds them"
        )
    return tuple(told)


def _holding(before: float, after: float) -> str:
    """What determines a scale; walls also determine parameters that bend them, on which it depends too."""
    if before >= _OBSERVED * after:
        return f"the {1e6 * after:.0f} ppm that are left of its sigma are the stored calibration's"
    return f"the stored calibration alone holds it, to {1e6 * after:.0f} ppm"


_NAMED_AT_MOST = 3
"""Directions that one sentence names."""
_ALIKE = {
    "radial scale": "planes look the same in a room that is wider in all directions by one share",
    "height scale": "planes look the same in a room that is higher by one share",
}


def _named(compared: Compared, index: int | np.integer, names: tuple[str, ...]) -> str:
    """The largest components of a direction, in units of the prior's standard deviations."""
    sigma = np.sqrt(np.maximum(np.diag(compared.prior), 0.0))
    part = np.abs(compared.direction[:, index]) / np.where(sigma > 0, sigma, np.inf)
    order = [i for i in np.argsort(-part, kind="stable")[:_NAMED] if part[i] >= _SHARE * part.max()]
    return ", ".join(names[i] for i in order)


def length_gains(before: Lengths, after: Lengths) -> tuple[LengthGain, ...]:
    """The lengths that are in reach of both calibrations, with their standard deviations."""
    new = {(laser.name, one.name, one.depth_m): one for laser in after.lasers for one in laser.lengths}
    return tuple(
        LengthGain(laser.name, one.name, one.depth_m, one.length_m, one.sigma_mm, found.sigma_mm)
        for laser in before.lasers
        for one in laser.lengths
        if (found := new.get((laser.name, one.name, one.depth_m))) is not None
    )


class Part(NamedTuple):
    """A part of the rig and how far it may have moved."""

    name: str
    names: tuple[str, ...]
    tolerance: tuple[float, ...]
    """Standard deviation of a move, for each of them [px, rad, m]."""
    together: tuple[str, ...] = ()
    """Coordinates that change by the same share of their tolerance: a lens that is refocused keeps square pixels."""


TABLE_PART = "table's angles"
# Chance below which the rig has drifted [1].
P_DRIFT = 1e-3
# A part that was knocked is within a degree and a few millimetres of its place.
_TILT, _SHIFT = np.radians(1.0), 5e-3
# A sheet turns about its laser, which is within some 0.1 m of the point of the sheet nearest the camera.
_SHEET = 2e-3
_FOCUS, _CENTRE_PX = 0.01, 20.0
_GAIN, _HARMONIC = 3e-3, 3e-3
# Pixels stay as square as that [1].
_SQUARE = 2e-5


def parts_of(scanner: Scanner) -> tuple[Part, ...]:
    """Parts of which at least one coordinate is not held by the stored calibration; lasers first."""
    focal = float(scanner.camera.fx), float(scanner.camera.fy)
    lasers = [
        Part(f"laser {name}", tuple(f"laser.{name}.{key}" for key in ("n1", "n2", "d")), (_TILT, _TILT, _SHEET))
        for name in scanner.laser_names
    ]
    axis = Part("axis", ("axis.d1", "axis.d2", "axis.p1", "axis.p2"), (_TILT, _TILT, _SHIFT, _SHIFT))
    camera = Part(
        "camera", ("fx", "fy", "cx", "cy"), (_FOCUS * focal[0], _FOCUS * focal[1], _CENTRE_PX, _CENTRE_PX), ("fx", "fy")
    )
    table = Part(TABLE_PART, ("gain", "c1", "s1", "c2", "s2"), (_GAIN, *(_HARMONIC,) * 4))
    parts = [*lasers, axis, camera, table] if isinstance(scanner.turntable, Turntable) else [*lasers, camera]
    return tuple(part for part in parts if loosening([part], scanner).any())


def loosening(
    parts: Sequence[Part], scanner: Scanner, without: Sequence[str] = ()
) -> Float[np.ndarray, "params params"]:
    """Variance that the moves of parts add to the prior; held coordinates stay held, some others keep their prior."""
    names = scanner.parameter_names()
    added = np.zeros((len(names), len(names)))
    held = np.diag(np.asarray(scanner.covariance)) <= 0
    for part in parts:
        at = {name: names.index(name) for name in part.names if name in names}
        free = {name: i for name, i in at.items() if not held[i] and name not in without}
        sigma = dict(zip(part.names, part.tolerance, strict=True))
        for name, i in free.items():
            share = _SQUARE / _FOCUS if name in part.together else 1.0
            added[i, i] += (share * sigma[name]) ** 2
        common = [name for name in part.together if name in free]
        if common:
            column = np.zeros(len(names))
            column[[free[name] for name in common]] = [sigma[name] for name in common]
            added += np.outer(column, column)
    return added


def describe_move(
    part: Part, names: Sequence[str], step: Float[np.ndarray, " params"], covariance: Float[np.ndarray, "params params"]
) -> str:
    """How far a part moved, in degrees, millimetres, pixels or ppm, with standard deviations."""
    words = []
    for kind, scale in _UNITS.items():
        here = [i for i, name in enumerate(names) if name in part.names and kind_of(name) == kind]
        size = float(np.linalg.norm(step[here]))
        if size > 0.0:
            along = step[here] / size
            sigma = float(np.sqrt(max(along @ covariance[np.ix_(here, here)] @ along, 0.0)))
            words.append(f"{_digits(scale * size, scale * sigma)} {kind}")
    return ", ".join(words)


_UNITS = {"degrees": float(np.degrees(1.0)), "mm": 1e3, "px": 1.0, "ppm": 1e6}


def kind_of(name: str) -> str:
    """The unit in which a coordinate is shown; empty for a coefficient."""
    whole, _, last = name.rpartition(".")
    if last in ("n1", "n2", "d1", "d2") or name in ("c1", "s1", "c2", "s2"):
        return "degrees"
    if whole and last in ("d", "p1", "p2"):
        return "mm"
    if name == "gain":
        return "ppm"
    return "px" if name in ("fx", "fy", "cx", "cy") else ""


def unit_of(name: str) -> tuple[str, float]:
    """The unit in which a coordinate's value is shown, and its factor; a ratio has none."""
    kind = kind_of(name)
    return ("", 1.0) if kind in ("", "ppm") else (kind, _UNITS[kind])


def _digits(value: float, sigma: float) -> str:
    """Value and sigma, both to two digits of the sigma."""
    if sigma <= 0.0:
        return f"{value:.3g}"
    places = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{places}f} ± {sigma:.{places}f}"


class Departure(NamedTuple):
    """The departure in the directions that gained: unit variance and independent where nothing moved."""

    value: Float[np.ndarray, " directions"]
    slope: Float[np.ndarray, "directions params"]
    """Its derivative by a move of the rig."""

    @property
    def chi2(self) -> float:
        """Sum of squares."""
        return float(self.value @ self.value)

    @property
    def p(self) -> float:
        """Chance of a larger one where nothing moved."""
        return chance_of(self.chi2, len(self.value))


class Explanation(NamedTuple):
    """The parts whose move explains a departure."""

    parts: tuple[Part, ...]
    p: float
    """Chance of a larger rest [1]."""
    others: tuple[tuple[Part, ...], ...] = ()
    """Parts whose move would explain it about as well, likeliest first."""


# A variance that became less by this share is measured rather than rounded. Little is enough: where the prior is tight,
# a part that moved is many of its standard deviations away.
_LEARNED = 1e-3
# A residual chi-squared with at least this chance is accepted.
_ORDINARY = 0.01
# One explanation is preferred to another if the data are this much likelier with it: 1000 to 1.
_DECISIVE = 2.0 * np.log(1000.0)
# Sizes of a move that are tried, as shares of the largest move of a part.
_SHARES = np.geomspace(0.005, 1.0, 24)


def departure_of(compared: Compared, step: Float[np.ndarray, " params"]) -> Departure:
    """The departure in the directions of which the data say something."""
    learned = 1.0 - compared.ratio
    seen = learned > _LEARNED
    learned, whiten = learned[seen], compared.whiten[seen]
    return Departure(whiten @ step / np.sqrt(learned), np.sqrt(learned)[:, None] * whiten)


def explain(departure: Departure, stored: Scanner) -> Explanation:
    """The fewest parts whose move leaves an ordinary rest of a departure by a solve with the stored prior.

    One part, or two, and others that would do as well; or all that there are, where two do not explain it.
    """
    parts = parts_of(stored)
    for count in (1, 2):
        found = [(rest_of(departure, loosening(some, stored)), some) for some in combinations(parts, count)]
        good = sorted([(rest, p, some) for (rest, p), some in found if p > _ORDINARY], key=lambda each: each[0])
        if good:
            near = [some for rest, _, some in good if rest - good[0][0] < _DECISIVE]
            return Explanation(near[0], good[0][1], tuple(near[1:]))
    return Explanation(parts, rest_of(departure, loosening(parts, stored))[1])


def rest_of(departure: Departure, added: Float[np.ndarray, "params params"]) -> tuple[float, float]:
    """Chi-squared that moves of this covariance leave, and the chance of a larger one."""
    left, size, _ = np.linalg.svd(departure.slope @ root_of(added).T, full_matrices=False)
    # Moves below the noise explain nothing.
    left = left[:, size > 1.0]
    rest = departure.chi2 - float(np.sum((left.T @ departure.value) ** 2))
    return rest, chance_of(rest, len(departure.value) - left.shape[1])


def _size_of(departure: Departure, added: Float[np.ndarray, "params params"]) -> float:
    """Twice the share of the tolerances of a move that makes the departure likeliest [1].

    A sheet that turned by a twentieth of a degree has not come nearer by millimetres, so the scale of the room keeps
    some of its hold.
    """
    left, size, _ = np.linalg.svd(departure.slope @ root_of(added).T, full_matrices=False)
    variance = 1.0 + np.outer(_SHARES, size) ** 2
    unlikely = np.sum(np.log(variance) + (left.T @ departure.value) ** 2 / variance, axis=1)
    return min(1.0, 2.0 * float(_SHARES[np.argmin(unlikely)]))


def move_of(departure: Departure, added: Float[np.ndarray, "params params"]) -> Float[np.ndarray, " params"]:
    """The likeliest move of this covariance [px, rad, m]."""
    root = root_of(added).T
    moves = departure.slope @ root
    return root @ np.linalg.solve(np.eye(moves.shape[1]) + moves.T @ moves, moves.T @ departure.value)


def loosened_prior(
    explanation: Explanation, departure: Departure, stored: Scanner, *, scale_known: bool
) -> Float[np.ndarray, "params params"]:
    """Variance added to the prior by the moves of an explanation.

    The parts of the likeliest move are set free, twice as far as is likeliest. Other moves that would explain the
    departure as well are one standard deviation away, so that the result covers both.

    A room that is larger by the same share as the distances of sheet and axis from the camera looks the same. So
    where both have moved and no length is known, those distances are loosened by no more than the move found.
    """
    parts = explanation.parts
    added = _size_of(departure, loosening(parts, stored)) ** 2 * loosening(parts, stored)
    if not scale_known and holds_no_scale(parts):
        names = stored.parameter_names()
        own = [name for part in parts for name in part.names if name in _AXIS or name.endswith(".d")]
        move, free = move_of(departure, added), np.diag(added) > 0
        added = loosening(parts, stored, without=own)
        for group in ([name for name in own if name in _AXIS], [name for name in own if name not in _AXIS]):
            at = [names.index(name) for name in group]
            added[at, at] = np.where(free[at], np.sum(move[at] ** 2), 0.0)
    for some in explanation.others:
        move = move_of(departure, loosening(some, stored))
        added = added + np.outer(move, move)
    return added


_AXIS = ("axis.p1", "axis.p2")


def holds_no_scale(parts: Sequence[Part]) -> bool:
    """Whether no unmoved part of the rig fixes the scale."""
    return any(part.name == "axis" for part in parts) and any(part.name.startswith("laser ") for part in parts)


Solving = Callable[[Scanner, Adjusted], Adjusted]
"""A solve with a prior, the stored scanner with any covariance, that begins where another ended."""
# Before a drift is known, every part may have moved by this share of its largest move.
_LOOSE = 0.1
# A scale that is known this much better than from the calibration is measured.
_MEASURED = 2.0


class Verdict(NamedTuple):
    """The verdict of an adjustment on the rig, and the prior that follows."""

    drift: Drift
    loosened: Float[np.ndarray, "params params"]
    """Variance that was added to the stored covariance."""
    adjusted: Adjusted
    """The solve with that prior."""
    notes: tuple[str, ...] = ()


def loose(stored: Scanner) -> Scanner:
    """The stored scanner with a covariance by which every part may have moved a little."""
    every = _LOOSE**2 * loosening(parts_of(stored), stored)
    return with_covariance(stored, np.asarray(stored.covariance) + every)


def with_covariance(scanner: Scanner, covariance: Float[np.ndarray, "params params"]) -> Scanner:
    """The same scanner with another covariance."""
    return eqx.tree_at(lambda s: s.covariance, scanner, covariance, is_leaf=lambda leaf: leaf is None)


def find_drift(stored: Scanner, free: Adjusted, solve: Solving) -> Verdict:
    """Tests whether anything moved, by a solve with the prior of `loose`, and solves with the prior that follows."""
    prior = np.asarray(stored.covariance)
    both = compare(np.asarray(free.prior.covariance), np.asarray(free.scanner.covariance))
    compared, step = with_prior(both, free.departure, prior)
    departure = departure_of(compared, step)
    drift = Drift(departure.chi2, len(departure.value), departure.p, departure.p < P_DRIFT)
    if not drift.drifted:
        return Verdict(drift, np.zeros_like(prior), solve(stored, free))
    found = explain(departure, stored)
    known = bool(scales_of(compared, scale_slopes(free.scanner, free.observations)).factor[0] >= _MEASURED)
    added = loosened_prior(found, departure, stored, scale_known=known)
    adjusted = solve(with_covariance(stored, prior + added), free)
    covariance = np.asarray(adjusted.scanner.covariance)
    alone = [move_of(departure, loosening(some, stored)) for some in found.others]
    moves = [(found.parts, adjusted.departure), *zip(found.others, alone, strict=True)]
    drift = replace(
        drift,
        part=" or ".join(" and ".join(part.name for part in some) for some, _ in moves),
        size=" or ".join(
            _size(some, stored, step, covariance if k == 0 else None) for k, (some, step) in enumerate(moves)
        ),
    )
    return Verdict(drift, added, adjusted, _notes(found, known))


def _size(
    parts: Sequence[Part], stored: Scanner, step: Float[np.ndarray, " params"], covariance: np.ndarray | None
) -> str:
    names = stored.parameter_names()
    none = np.zeros((len(names), len(names)))
    sizes = [
        (part.name, describe_move(part, names, step, none if covariance is None else covariance)) for part in parts
    ]
    return sizes[0][1] if len(sizes) == 1 else "; ".join(f"{name} {size}" for name, size in sizes if size)


def compared_of(verdict: Verdict, stored: Scanner) -> tuple[Compared, Compared]:
    """The final covariance beside the stored one, and beside the prior of the final solve."""
    prior, after = np.asarray(stored.covariance), np.asarray(verdict.adjusted.scanner.covariance)
    return compare(prior, after), compare(prior + verdict.loosened, after)


def _notes(found: Explanation, known: bool) -> tuple[str, ...]:
    told = []
    if found.others:
        names = " or ".join(" and ".join(part.name for part in some) for some in (found.parts, *found.others))
        told.append(f"{names}: these sweeps cannot tell which of them moved; the new covariance covers each")
    if found.p < P_DRIFT:
        told.append(
            f"moves of {', '.join(part.name for part in found.parts)} do not explain the whole departure "
            f"(p = {found.p:.1g}): the rig or the room is not as its model has it; check it with a board"
        )
    every = [*found.parts, *(part for some in found.others for part in some)]
    if holds_no_scale(every) and not known:
        told.append(
            "the sheet or the axis may have moved, or both, so their stored distances hold the scale of the room less "
            "firmly than before: give a known length or a capture of a board"
        )
    return tuple(told)


# A change is not tested where its variance by chance is a smaller share of the prior's.
_TOLD = 1e-6


def moved_parameters(
    stored: Scanner,
    step: Float[np.ndarray, " params"],
    compared: Compared,
    loosened: Float[np.ndarray, "params params"],
) -> tuple[Moved, ...]:
    """The change of every parameter that the stored calibration does not hold, by a step from it.

    With the prior $C_0 + D$ of a solve, its gain $G = I - C_1 (C_0 + D)^{-1}$, and a departure that is by chance alone,
    the change has the covariance $G C_0 G^T + G C_1$, which is $C_0 - C_1$ where nothing was loosened, D.
    """
    kept = (compared.direction * (1.0 - compared.ratio)) @ compared.whiten
    prior = compared.prior - loosened
    chance = kept @ prior @ kept.T + kept @ compared.posterior
    before, sigma = stored.values(), np.sqrt(np.maximum(np.diag(prior), 0.0))
    after = np.sqrt(np.maximum(np.diag(compared.posterior), 0.0))
    found = []
    for i, name in enumerate(stored.parameter_names()):
        if sigma[i] > 0:
            own = max(float(chance[i, i]), 0.0)
            size = float(step[i]) / np.sqrt(own) if own > _TOLD * sigma[i] ** 2 else 0.0
            value = float(before[i])
            told = (float(sigma[i]), float(after[i]), float(size), *unit_of(name))
            found.append(Moved(name, value, value + float(step[i]), *told))
    return tuple(found)
