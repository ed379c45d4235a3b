r"""Is the rig as it was when it was calibrated, and if not: which part moved?

Where nothing moved, the departure $d = s_1 - s_0$ of a joint solve from its prior has the covariance $C_0 - C_1$. In
the directions in which the data gained something that gives independent numbers $w$ of unit variance, and
$T = w^T w$ is chi-squared. A move $\delta$ of the rig beyond its prior shifts them to

$$E[w] = A \delta, \qquad A = (I - \Lambda)^{1/2} V^T L^{-1}$$

so which parts explain the departure is linear least squares: $T$ of the rest is chi-squared again, with as many
degrees of freedom less as the move has.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.chi_squared import chance_of
from jaxscan.geometry import Scanner, root_of
from jaxscan.recalibration.judge.compared import Compared
from jaxscan.recalibration.judge.parts import Part, loosening, parts_of


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
    """Those of the likeliest move."""
    p: float
    """Chance of a larger rest [1]."""
    others: tuple[tuple[Part, ...], ...] = ()
    """Parts whose move would explain it about as well, likeliest first."""


# A variance that became less by this share is measured rather than rounded. Little is enough: where the prior is tight,
# a part that moved is many of its standard deviations away.
_LEARNED = 1e-3
# A rest that comes about by chance this often is ordinary.
_ORDINARY = 0.01
# Of two explanations one is believed if the data are this much likelier with it: 1000 to 1.
_DECISIVE = 2.0 * np.log(1000.0)
# Moves that are tried, as shares of the largest move of a part.
_SHARES = np.geomspace(0.005, 1.0, 24)


def departure_of(compared: Compared, step: Float[np.ndarray, " params"]) -> Departure:
    """The departure in the directions of which the data say something."""
    learned = 1.0 - compared.ratio
    seen = learned > _LEARNED
    learned, whiten = learned[seen], compared.whiten[seen]
    return Departure(whiten @ step / np.sqrt(learned), np.sqrt(learned)[:, None] * whiten)


def explain(departure: Departure, stored: Scanner) -> Explanation:
    """The fewest parts whose move leaves an ordinary rest.

    Args:
        departure: By a solve with the stored prior.
        stored: The stored calibration's scanner with its covariance.

    Returns:
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
    # Moves that would be lost in the noise explain nothing.
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
    """Whether nothing is left that knows a distance once these parts have moved."""
    return any(part.name == "axis" for part in parts) and any(part.name.startswith("laser ") for part in parts)
