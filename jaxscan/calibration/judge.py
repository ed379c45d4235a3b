r"""Do the models of lens, board, table and sheet suffice? Tests of what is left in the residuals.

A score test (Rao) asks of every model whether terms that it does not have would be worth
having: with residuals $r$ at the minimum, derivatives $J$ by the unknowns and $E$ by the extra
terms, all whitened, and $g = E^T r$,

$$T = g^T V^{-1} g, \qquad V = E^T E - E^T J (J^T J)^{-1} J^T E$$

is chi-squared with as many degrees of freedom as terms that the unknowns cannot imitate. Nothing
is solved again, and the failing model is named. A cross-validation, two halves of the records
solved apart, asks the same of all models together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.adjust import Adjustment, linearise_compiled, solve_compiled
from jaxscan.calibration.covariance import chains, gram, prior_information, sum_blocks
from jaxscan.calibration.prepare import Prepared
from jaxscan.calibration.problem import Problem, Step, camera_from_board, move, zero_step
from jaxscan.calibration.rows import corner_rows, stripe_rows
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve import Blocks, reduce_blocks, schur_step
from jaxscan.geometry import Array, Turntable


# Degrees of the polynomials that stand for what a lens, a board and a sheet may do besides.
_LENS_DEGREE = 6
_RADIAL_POWERS = (4, 5)
_HEIGHT_DEGREE = 4
_PRINT_DEGREE = 3
_SHEET_DEGREES = (5, 1)
# Directions in which the unknowns imitate the extra terms but for this share are left out: what
# remains of them is as small as the second order of the projection, which is no noise. Of the next
# powers of the radius little else remains, and only their mean by second order is taken off.
_IMITATED = 1e-2
_RADIAL_IMITATED = 1e-3
# Directions of which one half of the records knows less than this share beyond the priors.
_PRIOR_HELD = 0.05
_ORDER = ("lens", "board", "table", "axis", "sheet")
_REPEATED = 0.05


class Test(NamedTuple):
    """Whether one model leaves structure in the residuals."""

    name: str
    statistic: float
    """With the detector's sigmas."""
    dof: int
    p: float
    """Probability of more by chance, if the detector's sigmas are right."""
    p_structure: float
    """The same, with the noise that was estimated: structure alone."""


ACCEPTED_P = 0.01
"""Chance of refusing good data, all tests together."""


def chance(p: Sequence[float]) -> float:
    """Probability that chance alone gives one of several tests a p as small as the smallest (Bonferroni's bound)."""
    return min(1.0, len(p) * min(p)) if p else 1.0


def judge(result: Adjustment, data: Prepared, settings: CalibrationSettings) -> list[Test]:
    """Test the models of a finished solve; call in 64 bit.

    Args:
        result: Of `adjust`.
        data: What was solved from.
        settings: Of the solve.

    Returns:
        Tests "lens", "board", "table" (its angles), "axis" (whether it stands still), "sheet" and
        "halves", those that the data allow.
    """
    corner_noise, stripe_noise = result.corner_noise, result.stripe_noise
    problem = result.problem
    scores = jax.tree.map(np.asarray, _scores(problem, _extents(data)))
    noise = {**dict.fromkeys(_ORDER, corner_noise), "sheet": stripe_noise}
    tests = []
    repeated = _repeated_views(problem, result.view_keep & data.usable)
    angle_statistic, angle_dof = 0.0, 0
    for name in (name for name in _ORDER if name in scores):
        score = scores[name]
        if name in ("table", "axis"):
            keep = np.repeat(repeated, len(score.gradient) // len(repeated))
            score = Score(score.gradient[keep], score.own[keep], score.variance[np.ix_(keep, keep)])
        statistic, dof = _statistic(score)
        if name == "lens":
            radial = _statistic(scores["radial"], _RADIAL_IMITATED)
            tests.append(_likelier_failure(_tested(name, statistic, dof, noise), _tested(name, *radial, noise)))
            continue
        if name == "table":
            angle_statistic, angle_dof = statistic, dof
        if name == "axis":
            # Beyond what a wrong angle at every stop would explain.
            statistic, dof = max(statistic - angle_statistic, 0.0), dof - angle_dof
        if dof > 0:
            tests.append(_tested(name, statistic, dof, noise))
    halves = _halves(result, data, settings, (1.0, 1.0))
    if halves is not None:
        given = halves
        if max(abs(corner_noise - 1.0), abs(stripe_noise - 1.0)) > _REPEATED:
            # Weights that promise what the detector promised.
            given = _halves(result, data, settings, (corner_noise, stripe_noise)) or halves
        tests.append(Test("halves", given[0], given[1], _p_value(*given), _p_value(*halves)))
    return tests


def _tested(name: str, statistic: float, dof: int, noise: dict[str, float]) -> Test:
    given = statistic * noise[name] ** 2
    return Test(name, given, dof, _p_value(given, dof), _p_value(statistic, dof))


def _likelier_failure(one: Test, other: Test) -> Test:
    """Of two tests of the same model the one that fails, if any; two chances of chance count."""
    worse = one if one.p_structure <= other.p_structure else other
    return worse._replace(p=min(1.0, 2.0 * worse.p), p_structure=min(1.0, 2.0 * worse.p_structure))


def _p_value(statistic: float, dof: int) -> float:
    if dof == 0:
        return 1.0
    return float(jax.scipy.special.gammaincc(0.5 * dof, 0.5 * max(statistic, 0.0)))


def _mean_residual(problem: Problem, blocks: Blocks) -> Float[Array, "views rows"]:
    r"""What the bend of the projection leaves in the mean of the corner residuals [px].

    $d = \frac{1}{2} \mathrm{tr}(H C)$, with $H$ the second derivatives of a residual and $C$ the covariance of the
    unknowns, less what the unknowns take up of it. Small, but terms that the unknowns imitate almost
    wholly are smaller.

    Source: Box, Bias in nonlinear estimation (1971).
    """
    reduced, coupling, _, _ = reduce_blocks(blocks, jnp.zeros((), blocks.shared.dtype))
    root = jnp.linalg.cholesky(jnp.linalg.inv(reduced))
    empty = jnp.diagonal(blocks.local, axis1=1, axis2=2) == 0
    filled = blocks.local + jax.vmap(jnp.diag)(empty.astype(root.dtype))
    own = jnp.linalg.cholesky(jnp.linalg.inv(filled))
    errors = lambda step: corner_rows(move(step, problem)).value
    here = errors(zero_step(problem))

    def bend(step):
        back = jax.tree.map(jnp.negative, step)
        return errors(step) + errors(back) - 2.0 * here

    shared = Step(root.T, -jnp.einsum("vdk,kj->jvd", coupling, root))
    local = Step(jnp.zeros((6, len(root)), root.dtype), jnp.moveaxis(own, 2, 0))
    steps = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), shared, local)
    return 0.5 * jax.lax.scan(lambda total, step: (total + bend(step), None), jnp.zeros_like(here), steps)[0]


class Score(NamedTuple):
    """Gradient of the cost by extra terms at the minimum, and its covariance."""

    gradient: Float[Array, " terms"]
    own: Float[Array, " terms"]
    """Diagonal of E'E: what the variance would be if nothing were estimated."""
    variance: Float[Array, "terms terms"]


def _statistic(score: Score, imitated: float = _IMITATED) -> tuple[float, int]:
    used = score.own > 0
    if not used.any():
        return 0.0, 0
    size = np.sqrt(score.own[used])
    values, vectors = np.linalg.eigh(score.variance[np.ix_(used, used)] / np.outer(size, size))
    seen = values > imitated
    parts = (vectors.T @ (score.gradient[used] / size))[seen] ** 2 / values[seen]
    return float(parts.sum()), int(seen.sum())


class _Extents(NamedTuple):
    """Centres and half sizes that make coordinates of image and stripes about -1 ... 1."""

    image: Float[Array, "2 2"]
    stripe: Float[Array, "2 2"]


def _extents(data: Prepared) -> _Extents:
    half = np.array(data.size) / 2.0
    points = data.stripe_q[data.stripe_valid] if data.stripe_valid.any() else np.zeros((1, 2))
    low, high = points.min(0), points.max(0)
    return _Extents(np.stack([half - 0.5, half]), np.stack([(low + high) / 2, np.maximum((high - low) / 2, 1.0)]))


@eqx.filter_jit
def _scores(problem: Problem, extents: _Extents) -> dict[str, Score]:
    """Scores of every model; those of table and axis have as many terms a view, of all views."""
    corners, (stripes, by_q) = corner_rows(problem), stripe_rows(problem)
    # Terms are functions of where things should have been seen: at the noisy places themselves they
    # would be correlated with the noise.
    square = jnp.sum(by_q * by_q, axis=-1)
    stripe_q = problem.stripe_q - by_q * (stripes.value / jnp.where(square > 0, square, 1.0))[..., None]
    corner_q = problem.corner_q + corners.value.reshape(problem.corner_q.shape)
    corner_weight = jnp.repeat(problem.corner_weight, 2, axis=1)
    corner_slopes = corners.slopes * corner_weight[..., None]
    stripe_slopes = stripes.slopes * problem.stripe_weight[..., None]
    corner_residual = corners.value * corner_weight
    chain = chains(problem)
    view_owner, stripe_owner = problem.placement, problem.stripe_placement()
    blocks = sum_blocks(
        gram(corner_slopes, chain.corner),
        gram(stripe_slopes, chain.stripe),
        prior_information(problem)[1],
        view_owner,
        stripe_owner,
        len(problem.poses),
    )
    camera = len(problem.camera.parameter_names())

    bend = _mean_residual(problem, blocks) * corner_weight

    def test_corners(extra: Array) -> Score:
        # The mean of the residuals is one more term, of known size, that the unknowns imitate in part.
        whole = jnp.concatenate([extra * corner_weight[..., None], bend[..., None]], axis=-1)
        score = test_everywhere(whole, corner_residual, corner_slopes, chain.corner, view_owner)
        gradient = score.gradient[:-1] - score.variance[:-1, -1]
        return Score(gradient, score.own[:-1], score.variance[:-1, :-1])

    def test_everywhere(extra: Array, residual: Array, slopes: Array, chain: Array, owner: Array) -> Score:
        met = jnp.einsum("vrm,vrd,kvd->vmk", extra, slopes, chain)
        own = jnp.einsum("vrm,vrn->mn", extra, extra)
        return _score(blocks, jnp.einsum("vrm,vr->m", extra, residual), own, met, owner)

    def test_views(extra: Array) -> Score:
        # Terms of each view's own: those of all other views do not meet them.
        views, _, terms = extra.shape
        met = jnp.einsum("vrm,vrd,kvd->vmk", extra, corner_slopes, chain.corner)
        own = jnp.einsum("vrm,vrn->vmn", extra, extra)
        apart = jnp.eye(views, dtype=extra.dtype)
        gradient = jnp.einsum("vrm,vr->vm", extra, corner_residual).ravel()
        spread = jnp.einsum("vmk,vw->vwmk", met, apart).reshape(views, views * terms, met.shape[2])
        whole = jnp.einsum("vmn,vw->vmwn", own, apart).reshape(views * terms, views * terms)
        return _score(blocks, gradient, whole, spread, view_owner)

    twist = corner_slopes[..., camera : camera + 6]
    scores = {
        "lens": test_corners(_lens_terms(corner_q, extents)),
        # Of all that a lens may do besides, the next powers of the radius are the likeliest; two terms
        # are noticed where a hundred would drown them.
        "radial": test_corners(_radial_terms(corner_q, extents)),
        "board": test_corners(_board_terms(problem, corners.slopes[..., camera : camera + 3])),
    }
    if problem.turntable is not None:
        table = problem.turntable
        turn = jax.vmap(lambda pose: turning_twist(pose, table))(camera_from_board(problem))
        scores["table"] = test_views(jnp.einsum("vrd,vd->vr", twist, turn)[..., None])
        scores["axis"] = test_views(twist)
    if len(problem.lasers.distance):
        scores["sheet"] = test_everywhere(
            _sheet_terms(stripe_q, problem, extents) * (jnp.sqrt(square) * problem.stripe_weight)[..., None],
            stripes.value * problem.stripe_weight,
            stripe_slopes,
            chain.stripe,
            stripe_owner,
        )
    return scores


def _score(blocks: Blocks, gradient: Array, own: Array, met: Array, owner: Array) -> Score:
    """Score and covariance of extra terms, from what they have in common with the unknowns.

    Args:
        blocks: Of J'J.
        gradient: E'r.
        own: E'E.
        met: E'J of every view or stripe, by the shared unknowns and its pose [owners, terms, unknowns].
        owner: Placement of each.
    """
    count = len(blocks.shared)
    shared = met[:, :, :count].sum(0)
    local = jnp.zeros((len(blocks.local), len(own), 6), own.dtype).at[owner].add(met[:, :, count:])

    def solved(shared_side, local_side):
        return schur_step(
            Blocks(blocks.shared, blocks.cross, blocks.local, shared_side, local_side), jnp.zeros((), own.dtype)
        )

    by_shared, by_local = jax.vmap(solved, in_axes=(0, 1))(shared, local)
    taken = shared @ by_shared.T + jnp.einsum("pmd,npd->mn", local, by_local)
    return Score(gradient, jnp.diagonal(own), own - taken)


def _lens_terms(q: Float[Array, "views corners 2"], extents: _Extents) -> Float[Array, "views rows terms"]:
    """Displacements of the image that are polynomials of the place in it [px]."""
    where = (q - extents.image[0][None, None]) / extents.image[1][None, None]
    field = _polynomials(where, _LENS_DEGREE)
    along, across = jnp.stack([field, jnp.zeros_like(field)], 2), jnp.stack([jnp.zeros_like(field), field], 2)
    terms = jnp.concatenate([along, across], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def _radial_terms(q: Float[Array, "views corners 2"], extents: _Extents) -> Float[Array, "views rows terms"]:
    """Displacements from the centre of the image as the next powers of the distance from it [px]."""
    away = (q - extents.image[0][None, None]) / jnp.linalg.norm(extents.image[1])
    square = jnp.sum(away * away, axis=-1)[..., None]
    terms = jnp.stack([away * square**power for power in _RADIAL_POWERS], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def _board_terms(problem: Problem, shift: Float[Array, "views rows 3"]) -> Float[Array, "views rows terms"]:
    """Shapes of the board: polynomial heights, and prints that are not true [px]."""
    where = (problem.board[:, :2] - problem.frame[None, :2]) / problem.frame[None, 2:]
    heights, prints = _polynomials(where, _HEIGHT_DEGREE), _polynomials(where, _PRINT_DEGREE)
    # What moves the whole board along its axes, moves one corner of it likewise.
    rows = lambda values: jnp.repeat(values, 2, axis=0)[None]
    parts = [
        shift[..., 0:1] * rows(prints),
        shift[..., 1:2] * rows(prints),
        shift[..., 2:3] * rows(heights),
    ]
    return jnp.concatenate(parts, axis=-1)


def _sheet_terms(
    q: Float[Array, "stripes points 2"], problem: Problem, extents: _Extents
) -> Float[Array, "stripes points terms"]:
    """Displacements of the stripe of each laser that are polynomials of the place in the image [px]."""
    where = (q - extents.stripe[0][None, None]) / extents.stripe[1][None, None]
    # Along the stripe any shape, across it (near and far) little.
    long = jnp.argmax(extents.stripe[1])
    first, second = jnp.take(where, long, axis=-1), jnp.take(where, 1 - long, axis=-1)
    along = jnp.stack([first**i for i in range(_SHEET_DEGREES[0] + 1)], -1)
    across = jnp.stack([second**i for i in range(_SHEET_DEGREES[1] + 1)], -1)
    field = (along[..., :, None] * across[..., None, :]).reshape(*first.shape, -1)
    lasers = len(problem.lasers.distance)
    own = problem.stripe_laser[:, None, None, None] == jnp.arange(lasers, dtype=jnp.int32)[None, None, :, None]
    return jnp.where(own, field[:, :, None, :], 0.0).reshape(*first.shape, -1)


def _polynomials(where: Float[Array, "... 2"], degree: int) -> Float[Array, "... terms"]:
    # Chebyshev's, which are less alike than powers.
    def chebyshev(x):
        values = [jnp.ones_like(x), x]
        for _ in range(degree - 1):
            values.append(2.0 * x * values[-1] - values[-2])
        return values

    x, y = chebyshev(where[..., 0]), chebyshev(where[..., 1])
    return jnp.stack([x[i] * y[j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)


def turning_twist(pose: Float[Array, "4 4"], table: Turntable) -> Float[Array, "6"]:
    """Twist (translation, rotation) of a board, in its own axes, that turning by 1 rad gives it in the image.

    Args:
        pose: T_cam_board; the axis is the same line at all angles, seen from the camera.
        table: With the camera on it.
    """
    # The camera moves about the axis, so the board moves the other way.
    back = pose[:3, :3].T
    axis = jnp.asarray(table.direction)
    return -jnp.concatenate([back @ jnp.cross(axis, pose[:3, 3] - table.point), back @ axis])


def _repeated_views(problem: Problem, used: np.ndarray) -> np.ndarray:
    """Views of placements that were seen from several angles: only there can a turn be wrong."""
    placement = np.asarray(problem.placement)
    count = np.bincount(placement[used], minlength=len(placement))
    return used & (count[placement] > 1)


def _halves(
    result: Adjustment, data: Prepared, settings: CalibrationSettings, promise: tuple[float, float]
) -> tuple[float, int] | None:
    """Distance of two calibrations from half of the records each, chi-squared; None where they cannot be had.

    Records are dealt out in turn inside each placement, so that both halves keep several angles.
    """
    half = deal_halves(np.asarray(data.placement), result.view_keep & data.usable)
    if min(np.count_nonzero(half == 0), np.count_nonzero(half == 1)) < 3:
        return None
    steps, sampling, total = [], [], []
    for side in (0, 1):
        views = half == side
        stripes = views[data.stripe_view]
        problem = eqx.tree_at(
            lambda p: (p.corner_weight, p.stripe_weight),
            result.problem,
            (
                result.problem.corner_weight * views[:, None] * promise[0],
                result.problem.stripe_weight * stripes[:, None] * promise[1],
            ),
        )
        solution = solve_compiled(problem, settings)
        known = linearise_compiled(solution.problem)
        free = np.asarray(problem.scales) > 0
        reduced, prior = (np.asarray(part)[np.ix_(free, free)] for part in (known.reduced, known.prior))
        size = np.sqrt(np.diag(reduced))
        if not np.all(size > 0) or not bool(solution.converged):
            return None
        correlation = reduced / np.outer(size, size)
        if np.linalg.eigvalsh(correlation)[0] < len(size) * np.finfo(float).eps:
            return None
        covariance = np.linalg.inv(correlation) / np.outer(size, size)
        # Priors are the same in both halves, so they scatter nothing.
        sampling.append(covariance @ (reduced - prior) @ covariance)
        total.append(covariance)
        steps.append(np.asarray(solution.step.shared)[free])
    root = np.linalg.cholesky(total[0] + total[1])
    scatter = np.linalg.solve(root, np.linalg.solve(root, sampling[0] + sampling[1]).T)
    values, vectors = np.linalg.eigh(0.5 * (scatter + scatter.T))
    seen = values > _PRIOR_HELD
    parts = (vectors.T @ np.linalg.solve(root, steps[0] - steps[1]))[seen] ** 2 / values[seen]
    return float(parts.sum()), int(seen.sum())


def deal_halves(placement: np.ndarray, used: np.ndarray) -> np.ndarray:
    """0 or 1 for every view that is used, else -1: in turn among views alone, and inside each placement."""
    half = np.full(len(placement), -1)
    count = np.bincount(placement[used], minlength=len(placement))
    alone = used & (count[placement] == 1)
    half[alone] = np.arange(alone.sum()) % 2
    for start, number in enumerate(np.flatnonzero(count > 1)):
        views = np.flatnonzero(used & (placement == number))
        half[views] = (np.arange(len(views)) + start) % 2
    return half
