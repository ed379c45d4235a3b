r"""The choice of the candidate that is the stripe, on each line.

By default that on the best path over the lines of a frame: a stripe goes on from line to line; a reflection rarely
does. On every line the path takes one candidate or none. A candidate adds to the score of the path

$$\min(\tfrac12 \mathrm{snr}^2, E) - \tfrac12 s_0^2,$$

the logarithm of its likelihood ratio against noise, less that of the faintest stripe that is believed on a line of its
own. It is cut off at E, so that one bright reflection does not outweigh many lines; a path that takes none on a line
loses the part of its best candidate beyond E. From one line to the next a path adds and pays

$$\tfrac12 (s_0^2 - s_1^2) - \min(\lambda |\Delta u|, J),$$

so that lines that continue each other need less signal each, and a jump costs the same however far it goes: depth has
edges. The width may change slowly only. Where a line takes none, the last centre is remembered, but counts less.

From step to step of the table the stripe on a surface moves along a nearly straight track. `check_steps` finds the
centres that lie on no track of the neighbouring profiles: they are reflections.

Source: dynamic programming along a stripe as of A. J. Viterbi, Error bounds for convolutional codes, IEEE Trans. Inf.
Theory 13, 1967, with costs that saturate.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int, Int8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import Choice, FrameStripes


_EVIDENCE = 20.0
"""Evidence beyond which a candidate is not better than another one."""
_CERTAIN_SNR = 14.0
"""Signal-to-noise ratio beyond which no more is lost by taking none [1]."""
_JUMP = 30.0
"""Largest cost of a change of the centre."""
_PER_PX = 0.3
"""Cost of a change of the centre [1/px]."""
_GAP_JUMP = 8.0
"""Largest cost of a change of the centre over lines without any."""
_WIDTH_COST = 0.5
"""Cost of a change of the width, per natural logarithm, up to one."""
_NEVER = -1e6
_BRIGHTER = 0.02
"""Score per natural logarithm of the amplitude."""
_BLOCK = 32
"""Profiles that are looked at together: intermediate arrays stay in a CPU's caches."""
_REACH = 3
_OFFSETS = tuple(o for o in range(-_REACH, _REACH + 1) if o != 0)
_TRACK_PX, _STEEPEST_PX = 1.5, 40.0
"""Distance of a centre from the line through two others of its track, and its largest movement in a step [px]."""
_LEAST_SUPPORT, _MORE_SUPPORT = 3, 2
"""Neighbours on the track of a candidate that may take the place of the chosen one, and how many more they must be."""
_LINES = 128
"""Lines that are compared at a time: the copies for it stay small beside the sweep itself."""


def on_image_lines(
    measured: FrameStripes, number: Int8[Array, "frames lines"] | None, sites: Sites, image_lines: int, *, several: bool
) -> tuple[FrameStripes, Int8[Array, "frames image_lines"] | None]:
    """The chosen stripes, or all candidates, on the lines of the image; pure and traceable.

    Args:
        measured: All candidates [frames, candidates, lines of the laser's plane].
        number: Of each line's stripe among them, -1 where there is none; None where nothing is chosen.
        sites: Where the laser's plane lies in the image.
        several: Whether all candidates are given.

    Returns:
        stripes: A profile per frame; with `several` one for each candidate.
        chosen: Number of each line's stripe among all candidates, -1 where there is none; None where one candidate is
            given, or nothing is chosen (`choice` "all").
    """
    frames, count, lines = measured.u.shape
    if several or number is None:
        stripes = jax.tree.map(lambda field: field.reshape(frames * count, lines), measured)
    else:

        def taken(field):
            found = jnp.zeros_like(field[:, 0])
            for k in range(count):
                found = jnp.where((number == k) & measured.valid[:, k], field[:, k], found)
            return found

        stripes, number = jax.tree.map(taken, measured), None

    def spread(values, nothing=0):
        if image_lines == lines:
            return values
        image = jnp.full((len(values), image_lines), nothing, values.dtype)
        last = sites.first_line + sites.line_step * lines
        return image.at[:, sites.first_line : last : sites.line_step].set(values)

    return jax.tree.map(spread, stripes), None if number is None else spread(number, -1)


def choose_stripes(measured: FrameStripes, search: Search, choice: Choice) -> Int8[Array, "frames lines"] | None:
    """The candidate of each line that is the stripe, -1 where there is none; None where all are (`choice` "all").

    Args:
        measured: All candidates [frames, candidates, lines].
        search: Which side is near, and the signal-to-noise ratios that are asked for.
    """
    if choice == "all":
        return None
    limits = search.limits
    if choice == "path":
        return best_path(measured, alone_snr=limits.min_snr, continued_snr=limits.continued_snr)
    side = search.near_side * measured.u
    rank = {"brightest": measured.amplitude, "nearest": side, "farthest": -side}[choice]
    rank = jnp.where(measured.valid & (measured.snr >= limits.min_snr), rank, -jnp.inf)
    best = jnp.argmax(rank, axis=1).astype(jnp.int8)
    return jnp.where(jnp.any(jnp.isfinite(rank), axis=1), best, jnp.int8(-1))


def best_path(
    candidates: FrameStripes, *, alone_snr: Float[Array, ""] | float, continued_snr: Float[Array, ""] | float
) -> Int8[Array, "frames lines"]:
    """The candidate on the best path of every line, or -1.

    Args:
        candidates: All candidates [frames, candidates, lines]; those that are not valid are never taken.
        alone_snr: Signal-to-noise ratio that a line on its own must exceed [1].
        continued_snr: The same where the neighbours continue the line [1].
    """
    u, snr, valid = candidates.u, candidates.snr, candidates.valid
    amplitude, width = jnp.maximum(candidates.amplitude, 1.0), jnp.maximum(candidates.width, 0.1)
    frames, count, _ = u.shape
    bonus = 0.5 * (alone_snr**2 - continued_snr**2)
    full = 0.5 * jnp.minimum(jnp.where(valid, snr, 0.0), _CERTAIN_SNR) ** 2
    score = jnp.minimum(full, _EVIDENCE) - 0.5 * alone_snr**2 + _BRIGHTER * jnp.log(amplitude)
    score = jnp.where(valid, score, _NEVER)
    lost = jnp.maximum(jnp.max(full, axis=1) - _EVIDENCE, 0.0)
    # Lines first, for the loop; then every operation is one vector over frames.
    place, score, log_width = (jnp.transpose(values, (2, 1, 0)) for values in (u, score, jnp.log(width)))

    def best_of(scores):
        best, origin = scores[0], jnp.zeros(frames, jnp.int8)
        for number, score in enumerate(scores[1:], 1):
            better = score > best
            best, origin = jnp.where(better, score, best), jnp.where(better, jnp.int8(number), origin)
        return best, origin

    def forward(state, line):
        # State 0 is none, with the centre of the last candidate before it.
        scores, places, widths = state
        here, scores_here, widths_here, lost_here = line
        best, origin = best_of(scores)
        remembered = places[0]
        for k in range(1, count + 1):
            remembered = jnp.where(origin == k, places[k], remembered)
        new_scores, origins = [best - lost_here], [origin]
        for k in range(count):
            moved = [scores[0] - jnp.minimum(_PER_PX * jnp.abs(here[k] - places[0]), _GAP_JUMP)]
            for j in range(1, count + 1):
                change = jnp.minimum(_PER_PX * jnp.abs(here[k] - places[j]), _JUMP)
                change += _WIDTH_COST * jnp.minimum(jnp.abs(widths_here[k] - widths[j - 1]), 1.0)
                moved.append(scores[j] + bonus - change)
            best, origin = best_of(moved)
            new_scores.append(best + scores_here[k])
            origins.append(origin)
        return (new_scores, [remembered, *here], list(widths_here)), jnp.stack(origins)

    zero = jnp.zeros(frames, u.dtype)
    # Nothing is remembered at first: a place so far away costs the same for all.
    first = ([zero] + [zero + _NEVER] * count, [zero + _NEVER] + [zero] * count, [zero] * count)
    (scores, _, _), origins = lax.scan(forward, first, (place, score, log_width, lost.T))
    _, last = best_of(scores)

    def backward(taken, origin):
        before = origin[0]
        for k in range(1, count + 1):
            before = jnp.where(taken == k, origin[k], before)
        return before, taken

    _, path = lax.scan(backward, last, origins, reverse=True)
    return path.T - jnp.int8(1)


def chosen_of(stripes: FrameStripes, chosen: Int8[Array, "frames lines"] | None) -> FrameStripes:
    """The chosen ones among all candidates [frames * K, lines]; all of them where nothing is chosen."""
    if chosen is None:
        return stripes
    return jax.tree.map(lambda field: _taken(np.asarray(field), np.asarray(chosen)), stripes)


def pick_by_steps(
    fields: dict[str, np.ndarray],
    chosen: Int8[np.ndarray, "profiles lines"],
    laser: Int[np.ndarray, " profiles"],
    angle: Float[np.ndarray, " profiles"],
) -> dict[str, np.ndarray]:
    """One candidate of every line: the chosen one, unless `check_steps` knows better.

    Args:
        fields: Fields of all candidates [profiles * K, lines, ...], those of a profile following each other.
        chosen: Number of each line's candidate, -1 where there is none.
        laser: Which laser lit each profile.
        angle: The table's angle of each profile [rad].

    Returns:
        The fields [profiles, lines, ...], zero where there is no stripe.
    """
    profiles, lines = chosen.shape
    u, valid = (fields[name].reshape(profiles, -1, lines) for name in ("u", "valid"))
    new = chosen.copy()
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        own = own[np.argsort(angle[own], kind="stable")]
        for start in range(0, lines, _LINES):
            part = slice(start, start + _LINES)
            candidates, exists = (np.moveaxis(field[own, :, part], 1, 2) for field in (u, valid))
            with jax.enable_x64(False):
                new[own, part] = np.asarray(check_steps(candidates, exists, chosen[own, part]))
    return {name: _taken(field, new) for name, field in fields.items()}


def _taken(field: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The entries of a field [profiles * K, lines, ...] for the chosen candidates; zero where there is none."""
    rest = (1,) * (field.ndim - 2)
    number = np.maximum(chosen, 0).astype(np.intp).reshape(len(chosen), 1, -1, *rest)
    taken = np.take_along_axis(field.reshape(len(chosen), -1, *field.shape[1:]), number, 1)[:, 0]
    return np.where((chosen >= 0).reshape(*chosen.shape, *rest), taken, taken.dtype.type(0))


@jax.jit
def check_steps(
    u: Float[Array, "profiles lines K"], exists: Bool[Array, "profiles lines K"], chosen: Int8[Array, "profiles lines"]
) -> Int8[Array, "profiles lines"]:
    """Choose again where the neighbouring profiles know better.

    The support of a candidate is the largest number of chosen centres, within 3 steps on either
    side, that lie on one straight line with it; a line needs two of them, which may be on one
    side. Another candidate takes the place of the chosen one where its support is clearly larger. At
    last a chosen centre is dropped if it has no support, and none close to it in the steps next to
    it, while at least two neighbours on either side lie on a line that passes it by: an object that is seen in a single
    step, a thread before a wall, goes with them. At the end of a surface the neighbours of one side support it, and
    those of both sides do not agree: there, as everywhere without evidence, nothing is changed.

    Args:
        u: Centres of the candidates [px]; the profiles are one laser's, in the order of the turning and
            equally spaced.
        chosen: Number of the chosen candidate, -1 where there is none; these stay -1.
    """
    profiles, lines, candidates = u.shape
    blocks = -(-profiles // _BLOCK)
    after = (0, blocks * _BLOCK - profiles)
    # Planes per candidate: as the last axis, three numbers would keep the loops from being vectorised.
    planes = lambda field: jnp.pad(jnp.moveaxis(jnp.asarray(field), -1, 0), ((0, 0), after, (0, 0)))
    centres, known = planes(u), planes(exists)
    choice = jnp.pad(jnp.asarray(chosen), (after, (0, 0)), constant_values=-1)
    # Twice: a corrected centre helps its neighbours.
    for last in (False, True):
        centre, there = jnp.zeros_like(centres[0]), jnp.zeros_like(known[0])
        for k in range(candidates):
            centre, there = jnp.where(choice == k, centres[k], centre), there | ((choice == k) & known[k])
        centre, there = (jnp.pad(field, ((_REACH, _REACH), (0, 0))) for field in (centre, there))

        def block(start, centre=centre, there=there, choice=choice, last=last):
            cut = lambda a, size, axis=0: lax.dynamic_slice_in_dim(a, start, size, axis)
            track = cut(centre, _BLOCK + 2 * _REACH), cut(there, _BLOCK + 2 * _REACH)
            own = cut(centres, _BLOCK, 1), cut(known, _BLOCK, 1)
            return _choose(track, own, cut(choice, _BLOCK), reject=last)

        choice = lax.map(block, jnp.arange(blocks) * _BLOCK).reshape(blocks * _BLOCK, lines)
    return choice[:profiles]


def _choose(
    track: tuple[Float[Array, "around lines"], Bool[Array, "around lines"]],
    candidates: tuple[Float[Array, "K block lines"], Bool[Array, "K block lines"]],
    choice: Int8[Array, "block lines"],
    *,
    reject: bool,
) -> Int8[Array, "block lines"]:
    """The new choice of a block of profiles; the track of chosen centres has 3 more on either side."""
    block = choice.shape[0]
    (centre, there), (own, known) = track, candidates
    at = {o: (centre[_REACH + o :][:block], there[_REACH + o :][:block]) for o in _OFFSETS}
    lines = {}
    for i, j in itertools.combinations(_OFFSETS, 2):
        (u_i, there_i), (u_j, there_j) = at[i], at[j]
        slope = (u_j - u_i) * (1.0 / (j - i))
        lines[i, j] = u_i - i * slope, slope, there_i & there_j & (jnp.abs(slope) <= _STEEPEST_PX)
    best = jnp.zeros(choice.shape, jnp.int8)
    support, better = best, choice
    for k in range(own.shape[0]):
        found = jnp.where(known[k], _support(own[k], lines), jnp.int8(0))
        support = jnp.where(choice == k, found, support)
        better = jnp.where(found > best, jnp.int8(k), better)
        best = jnp.maximum(found, best)
    swap = (choice >= 0) & (best >= _LEAST_SUPPORT) & (best >= support + jnp.int8(_MORE_SUPPORT))
    new = jnp.where(swap, better, choice)
    if not reject:
        return new
    passed_by = _passed_by(at, lines, centre[_REACH:][:block])
    return jnp.where((choice >= 0) & ~swap & (support == 0) & passed_by, jnp.int8(-1), new)


def _support(own: Array, lines: dict) -> Int8[Array, "block lines"]:
    """Largest number of neighbours on one straight line with a candidate; 0 where no two are."""
    total = {o: jnp.zeros(own.shape, jnp.int8) for o in _OFFSETS}
    for (i, j), (meets, _, usable) in lines.items():
        # The nearer neighbour's distance from the line through the candidate and the farther one.
        near, far = sorted((i, j), key=abs)
        agrees = (usable & (jnp.abs(meets - own) <= _TRACK_PX / (1.0 - near / far))).astype(jnp.int8)
        total[i], total[j] = total[i] + agrees, total[j] + agrees
    most = functools.reduce(jnp.maximum, total.values())
    return jnp.where(most > 0, most + jnp.int8(1), jnp.int8(0))


def _passed_by(at: dict, lines: dict, own: Array) -> Bool[Array, "block lines"]:
    """Whether two neighbours on either side lie on a straight line that is far from a lone centre."""
    apart = 3.0 * _TRACK_PX
    alone = jnp.ones(own.shape, jnp.bool_)
    for u, there in (at[-1], at[1]):
        alone &= ~(there & (jnp.abs(u - own) <= apart))
    result = jnp.zeros(own.shape, jnp.bool_)
    for (i, j), (meets, slope, usable) in lines.items():
        if i > 0 or j < 0:
            continue
        both = usable & (jnp.abs(meets - own) > apart)
        for side in (-1, 1):
            others = [o for o in _OFFSETS if o * side > 0 and o not in (i, j)]
            on_line = [at[o][1] & (jnp.abs(at[o][0] - meets - o * slope) <= _TRACK_PX) for o in others]
            both &= on_line[0] | on_line[1]
        result = result | both
    return alone & result
