"""Candidates against those of the neighbouring steps: a surface moves smoothly, a reflection does not.

From step to step the stripe on a surface moves along a nearly straight track. A centre that the path along
the lines of one profile chose, and that lies on no track of the neighbouring profiles, is a reflection.
"""

import functools
import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float, Int8

from jaxscan.geometry import Array


_BLOCK = 32
"""Profiles that are looked at together: intermediate arrays stay in a CPU's caches."""
_REACH = 3
_OFFSETS = tuple(o for o in range(-_REACH, _REACH + 1) if o != 0)
_PAIRS = tuple(itertools.combinations(_OFFSETS, 2))


@dataclass(frozen=True)
class StepSettings:
    """The definition of a track; static, so a change recompiles."""

    tolerance_px: float = 1.5
    """Distance of a centre from the straight line through two others of its track [px]."""
    max_slope_px: float = 40.0
    """Largest movement of a stripe from step to step [px]."""
    min_support: int = 3
    """Neighbours on the track of a candidate that may take the place of the chosen one."""
    margin: int = 2
    """By how many neighbours its track must be better."""
    passes: int = 2
    """How often the candidates are compared: a corrected centre helps its neighbours."""
    drop: bool = True
    """Whether centres that the neighbours pass by are dropped. An object seen in a single step, a
    thread before a wall, goes with them."""

    def __post_init__(self) -> None:
        if not (self.tolerance_px > 0 and self.max_slope_px > 0):
            raise ValueError("`tolerance_px` and `max_slope_px` must be positive.")
        if self.min_support < 2 or self.margin < 1 or self.passes < 1:
            raise ValueError("`min_support` must be at least 2, `margin` and `passes` at least 1.")


_SETTINGS = StepSettings()


@functools.partial(jax.jit, static_argnames="settings")
def check_steps(
    u: Float[Array, "profiles lines K"],
    exists: Bool[Array, "profiles lines K"],
    chosen: Int8[Array, "profiles lines"],
    settings: StepSettings = _SETTINGS,
) -> Int8[Array, "profiles lines"]:
    """Choose again where the neighbouring profiles know better.

    The support of a candidate is the largest number of chosen centres, within 3 steps on either
    side, that lie on one straight line with it; a line needs two of them, which may be on one
    side. Another candidate takes the place of the chosen one where its support is clearly larger. At
    last a chosen centre is dropped if it has no support, and none close to it in the steps next to
    it, while at least two neighbours on either side lie on a line that passes it by. At the end of a
    surface the neighbours of one side support it, and those of both sides do not agree: there, as
    everywhere without evidence, nothing is changed.

    Args:
        u: Centres of the candidates [px]; the profiles are one laser's, in the order of the turning and
            equally spaced.
        exists: Which candidates there are.
        chosen: Number of the chosen candidate, -1 where there is none; these stay -1.
        settings: The definition of a track.

    Returns:
        The new choice.
    """
    profiles, lines, candidates = u.shape
    blocks = -(-profiles // _BLOCK)
    after = blocks * _BLOCK - profiles
    # Planes per candidate: as the last axis, three numbers would keep the loops from being vectorised.
    centres, known = jnp.moveaxis(jnp.asarray(u), -1, 0), jnp.moveaxis(jnp.asarray(exists), -1, 0)
    centres = jnp.pad(centres, ((0, 0), (0, after), (0, 0)))
    known = jnp.pad(known, ((0, 0), (0, after), (0, 0)))
    choice = jnp.pad(jnp.asarray(chosen), ((0, after), (0, 0)), constant_values=-1)
    for number in range(settings.passes):
        last = settings.drop and number == settings.passes - 1
        centre = functools.reduce(
            lambda value, k: jnp.where(choice == k, centres[k], value), range(candidates), jnp.zeros_like(centres[0])
        )
        there = functools.reduce(lambda value, k: value | ((choice == k) & known[k]), range(candidates), choice < -1)
        margin = ((_REACH, _REACH), (0, 0))
        centre, there = jnp.pad(centre, margin), jnp.pad(there, margin)

        def block(start, centre=centre, there=there, choice=choice, last=last):
            cut = lambda a, size, axis=0: lax.dynamic_slice_in_dim(a, start, size, axis)
            track = cut(centre, _BLOCK + 2 * _REACH), cut(there, _BLOCK + 2 * _REACH)
            own = cut(centres, _BLOCK, 1), cut(known, _BLOCK, 1)
            return _choose(track, own, cut(choice, _BLOCK), settings, reject=last)

        choice = lax.map(block, jnp.arange(blocks) * _BLOCK).reshape(blocks * _BLOCK, lines)
    return choice[:profiles]


def _choose(
    track: tuple[Float[Array, "around lines"], Bool[Array, "around lines"]],
    candidates: tuple[Float[Array, "K block lines"], Bool[Array, "K block lines"]],
    choice: Int8[Array, "block lines"],
    settings: StepSettings,
    *,
    reject: bool,
) -> Int8[Array, "block lines"]:
    """The new choice of a block of profiles; the track of chosen centres has 3 more on either side."""
    block = choice.shape[0]
    (centre, there), (own, known) = track, candidates
    at = {o: (centre[_REACH + o :][:block], there[_REACH + o :][:block]) for o in _OFFSETS}
    lines = {}
    for i, j in _PAIRS:
        (u_i, there_i), (u_j, there_j) = at[i], at[j]
        slope = (u_j - u_i) * (1.0 / (j - i))
        lines[i, j] = u_i - i * slope, there_i & there_j & (jnp.abs(slope) <= settings.max_slope_px)

    best = jnp.zeros(choice.shape, jnp.int8)
    support = jnp.zeros(choice.shape, jnp.int8)
    better = choice
    for k in range(own.shape[0]):
        found = jnp.where(known[k], _support(own[k], lines, settings), jnp.int8(0))
        support = jnp.where(choice == k, found, support)
        better = jnp.where(found > best, jnp.int8(k), better)
        best = jnp.maximum(found, best)
    swap = (choice >= 0) & (best >= settings.min_support) & (best >= support + jnp.int8(settings.margin))
    new = jnp.where(swap, better, choice)
    if not reject:
        return new
    passed_by = _passed_by(at, lines, centre[_REACH:][:block], settings)
    return jnp.where((choice >= 0) & ~swap & (support == 0) & passed_by, jnp.int8(-1), new)


def _support(own: Array, lines: dict, settings: StepSettings) -> Int8[Array, "block lines"]:
    """Largest number of neighbours on one straight line with a candidate; 0 where no two are."""
    total = {o: jnp.zeros(own.shape, jnp.int8) for o in _OFFSETS}
    for (i, j), (meets, usable) in lines.items():
        # The nearer neighbour's distance from the line through the candidate and the farther one.
        near, far = sorted((i, j), key=abs)
        agrees = (usable & (jnp.abs(meets - own) <= settings.tolerance_px / (1.0 - near / far))).astype(jnp.int8)
        total[i], total[j] = total[i] + agrees, total[j] + agrees
    most = functools.reduce(jnp.maximum, total.values())
    return jnp.where(most > 0, most + jnp.int8(1), jnp.int8(0))


def _passed_by(at: dict, lines: dict, own: Array, settings: StepSettings) -> Bool[Array, "block lines"]:
    """Whether two neighbours on either side lie on a straight line that is far from a lone centre."""
    apart = 3.0 * settings.tolerance_px
    alone = ~functools.reduce(lambda a, b: a | b, (at[o][1] & (jnp.abs(at[o][0] - own) <= apart) for o in (-1, 1)))
    result = jnp.zeros(own.shape, jnp.bool_)
    for (i, j), (meets, usable) in lines.items():
        if i > 0 or j < 0:
            continue
        (u_i, _), (u_j, _) = at[i], at[j]
        slope = (u_j - u_i) * (1.0 / (j - i))
        sides = {}
        for side in (-1, 1):
            others = [o for o in _OFFSETS if o * side > 0 and o not in (i, j)]
            on_line = [at[o][1] & (jnp.abs(at[o][0] - meets - o * slope) <= settings.tolerance_px) for o in others]
            sides[side] = on_line[0] | on_line[1]
        far = jnp.abs(meets - own) > apart
        result = result | (usable & far & sides[-1] & sides[1])
    return alone & result
