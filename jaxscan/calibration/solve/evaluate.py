"""Errors of all views and stripes at a point, with their derivatives, part by part.

A part has a fixed number of views or stripes, so captures of any length run the same compiled functions, and a
solve of the corners alone runs nothing for stripes. What these functions give depends on no weight, so new
weights need no new evaluation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.solve.problem import Problem, Step, camera_from_board, move, zero_step
from jaxscan.calibration.solve.residuals import priors
from jaxscan.calibration.solve.rows import Departures, corner_rows, departures, stripe_rows
from jaxscan.compiling import compile_quickly, compile_sooner
from jaxscan.geometry import Array


_STRIPES = 8
"""Stripes that are evaluated by one call."""
_VIEWS = 24
"""Views that are: a corner costs less than the call."""


class CornerPart(NamedTuple):
    """The corners of some views."""

    error: Float[Array, "views rows"]
    """Projected minus observed corners, u and v of each [px]."""
    slopes: Float[Array, "views rows departures"]
    """Derivatives by the departures of their view."""
    chain: Float[Array, "views departures unknowns"]
    """Derivatives of the departures by the shared scaled unknowns and the pose of the view."""
    pose: Float[Array, "views 4 4"]
    """T_cam(phi)_board."""


class StripePart(NamedTuple):
    """The points of some stripes."""

    offset: Float[Array, "stripes points"]
    """Distance e of a point, lifted to its board, from its sheet [m]."""
    slopes: Float[Array, "stripes points departures"]
    """Derivatives by the departures of their stripe."""
    chain: Float[Array, "stripes departures unknowns"]
    """Derivatives of the departures by the shared scaled unknowns and the pose of the view."""
    by_q: Float[Array, "stripes points 2"]
    """grad_q e [m / px]."""


class PriorPart(NamedTuple):
    """The priors."""

    residual: Float[Array, " shared"]
    slopes: Float[Array, "shared shared"]
    """Derivatives by the shared scaled unknowns."""


class Evaluated(NamedTuple):
    """Everything at a point, without weights, on the host; zero for padding."""

    corners: CornerPart
    stripes: StripePart
    priors: PriorPart


def evaluate(problem: Problem) -> Evaluated:
    """Errors and derivatives at the point that the problem holds; call in 64 bit."""
    shared = _without_views(problem)
    # All are begun before the first is awaited.
    views = [(some, _corner_part(_of_views(problem, shared, some))) for some in _parts(problem.seen, _VIEWS)]
    lines = [(some, _stripe_part(_of_stripes(problem, shared, some))) for some in _parts(problem.lit, _STRIPES)]
    priors_there = _prior_part(shared)
    corners, stripes = _no_corners(problem), _no_stripes(problem)
    _fill(corners, views)
    _fill(stripes, lines)
    return Evaluated(corners, stripes, PriorPart(*map(np.asarray, priors_there)))


def moved(step: Step, problem: Problem) -> Problem:
    """`move` on the host, where nothing is compiled."""
    return jax.tree.map(np.asarray, move(Step(*map(np.asarray, step)), jax.tree.map(np.asarray, problem)))


def _parts(there: Bool[Array, " owners"], size: int) -> list[np.ndarray]:
    """Numbers of the owners that are there, so many at a time."""
    numbers = np.flatnonzero(np.asarray(there))
    return [numbers[start : start + size] for start in range(0, len(numbers), size)]


def _fill(whole: Sequence[Array], parts: Sequence[tuple[np.ndarray, Sequence[Array]]]) -> None:
    """Put what was found for some owners into the NumPy arrays of all."""
    for some, part in parts:
        for field, values in zip(whole, part, strict=True):
            np.asarray(field)[some] = np.asarray(values)[: len(some)]


def _of_views(problem: Problem, shared: Problem, some: np.ndarray) -> Problem:
    """Some views alone, each a placement of its own, without stripes; filled up to a part."""
    some = np.concatenate([some, np.repeat(some[:1], _VIEWS - len(some))])
    return replace(
        shared,
        **_placed(problem, some),
        corner_q=np.asarray(problem.corner_q)[some],
        corner_weight=np.asarray(problem.corner_weight)[some],
    )


def _of_stripes(problem: Problem, shared: Problem, some: np.ndarray) -> Problem:
    """Some stripes alone, each on a board of its own, with corners that nobody reads; filled up to a part."""
    some = np.concatenate([some, np.repeat(some[:1], _STRIPES - len(some))])
    return replace(
        shared,
        **_placed(problem, np.asarray(problem.stripe_view)[some]),
        corner_q=np.zeros((_STRIPES, *problem.corner_q.shape[1:])),
        corner_weight=np.zeros((_STRIPES, *problem.corner_weight.shape[1:])),
        stripe_q=np.asarray(problem.stripe_q)[some],
        stripe_weight=np.asarray(problem.stripe_weight)[some],
        stripe_view=np.arange(_STRIPES, dtype=np.int32),
        stripe_laser=np.asarray(problem.stripe_laser)[some],
        lit=np.ones(_STRIPES, bool),
    )


def _placed(problem: Problem, views: np.ndarray) -> dict[str, Any]:
    """The fields of some views, each a placement of its own."""
    return {
        "poses": np.asarray(problem.poses)[np.asarray(problem.placement)[views]],
        "angle": np.asarray(problem.angle)[views],
        "placement": np.arange(len(views), dtype=np.int32),
        "seen": np.ones(len(views), bool),
    }


def _without_views(problem: Problem) -> Problem:
    """The shared unknowns alone."""
    poses = ("poses", "angle", "placement", "seen", "corner_q", "corner_weight")
    stripes = ("stripe_q", "stripe_weight", "stripe_view", "stripe_laser", "lit")
    empty: dict[str, Any] = {name: np.asarray(getattr(problem, name))[:0] for name in poses + stripes}
    return replace(problem, **empty)


def _no_corners(problem: Problem) -> CornerPart:
    """All views, to be filled; the poses are those of views that nobody sees."""
    views, corners = problem.corner_weight.shape
    departures = len(problem.camera.parameter_names()) + 6 + len(problem.shape)
    return CornerPart(
        np.zeros((views, 2 * corners)),
        np.zeros((views, 2 * corners, departures)),
        np.zeros((views, departures, len(problem.scales) + 6)),
        np.asarray(problem.poses)[np.asarray(problem.placement)],
    )


def _no_stripes(problem: Problem) -> StripePart:
    """All stripes, to be filled."""
    stripes, points = problem.stripe_weight.shape
    departures = len(problem.camera.parameter_names()) + 14 + len(problem.modes.height)
    return StripePart(
        np.zeros((stripes, points)),
        np.zeros((stripes, points, departures)),
        np.zeros((stripes, departures, len(problem.scales) + 6)),
        np.zeros((stripes, points, 2)),
    )


@compile_sooner
def _corner_part(problem: Problem) -> CornerPart:
    rows = corner_rows(problem)
    return CornerPart(rows.value, rows.slopes, chains(problem).corner, camera_from_board(problem))


@compile_sooner
def _stripe_part(problem: Problem) -> StripePart:
    rows, by_q = stripe_rows(problem)
    return StripePart(rows.value, rows.slopes, chains(problem).stripe, by_q)


def chains(problem: Problem) -> Departures:
    """Derivatives of the departures by the shared unknowns and their own pose [owners, departures, unknowns]."""
    start = zero_step(problem)
    count = len(start.shared)
    product = jax.linearize(lambda step: departures(step, problem), start)[1]
    # Behind the barrier, or the compiler works out products with these constants itself, slowly.
    unit = jax.lax.optimization_barrier(jnp.eye(count + 6, dtype=start.shared.dtype))
    # Poses of different placements meet different views, so all are moved at once.
    follow = lambda e: product(Step(e[:count], jnp.broadcast_to(e[None, count:], start.local.shape)))
    return jax.vmap(follow, out_axes=2)(unit)


@compile_quickly
def _prior_part(problem: Problem) -> PriorPart:
    start = zero_step(problem)
    move_priors = lambda shared: priors(move(Step(shared, start.local), problem))
    return PriorPart(priors(problem), jax.jacfwd(move_priors)(start.shared))
