"""How many stripes chance would find: the same search in frames whose difference is turned round.

Noise, texture and motion give as many stripes where laser-on and laser-off frame are exchanged; the laser gives none.
What is no clearer than most of these decoys is chance, and tells how many stripes of chance there are for each decoy;
the decoys above a threshold, times that, are the stripes of chance above it. (J. E. Elias, S. P. Gygi, Target-decoy
search strategy, Nature Methods 4, 2007; the rate as of J. D. Storey, A direct approach to false discovery rates,
J. R. Stat. Soc. B 64, 2002.) The threshold leaves one in 500: lines are left out, not sweeps.

What parts stripes from decoys is that a laser's line goes on, from line to line and from profile to profile, while
what is printed on a wall moves on with the room; and that it is bright. Where a camera stands still the room goes on as
well, and brightness decides; where profiles are far apart nothing goes on from one to the next, and the lines of one
profile tell alone. `clearness` has a measure for each, and of the first two the one that leaves more is taken.

A sweep is refused where all may be chance: fewer than 16 stripes go on further than decoys do, or are brighter where
decoys go on as well as stripes; and less than a quarter of all are clearer by the third measure, as bright print, which
is commoner than dark print, makes up to a fifth of a mono camera's stripes brighter than all decoys.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import CaptureError
from jaxscan.reconstruction.plan import Plan
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import ChunkStripes, chosen_of


_RUN, _RUNS, _RUNS_WITHOUT_OFF = 5, 2, 4
"""Neighbouring profiles that are searched for decoys, and at how many places of the sweep."""
_LINES, _PROFILES = 5, 2
"""Neighbours on either side with which a stripe is compared."""
_NOISE_PX, _SLOPE = 0.5, 0.5
"""Distance of neighbours' centres up to which they go on with each other [px], and what is added for each line [px]."""
_APART_PX, _DRIFT, _LEAST_DRIFT_PX = 6.0, 1 / 16, 1.0
"""Motion of the room between profiles that are compared, at least [px]; the part of it that is added for each profile,
and at least so much [px]."""
_AT_ONCE = 256
"""Profiles that are looked at together."""
_SHARE, _LUCK, _MOST = 0.002, 2.5, 0.05
"""Part of what is kept that chance may have, as decoys tell it, which in single rooms is twice as much; with so many
sigmas of luck where all is kept; and the part up to which all is kept where no threshold can be set."""
_RATE = 1.5
"""Stripes of chance for each decoy, at most: bright print is commoner than dark print."""
_CERTAIN, _KEPT = 16, 0.25
"""Stripes, and part of them, that chance does not give."""
_STANDS = 0.9
"""Part of their neighbours with which decoys go on where a camera stands still."""
_PER_PROFILE = 2.0
"""Stripes of a profile, on average over the sweep, below which they may all be chance."""
_HELPS = "narrower range limits, one dark picture as --off of `jaxscan import`, or the right --laser-colour"


@dataclass(frozen=True)
class Chance:
    """The verdict of the decoys on the stripes of a sweep."""

    least: float = 0.0
    """Smallest clearness (`clearness`) of a stripe that is accepted; 0 for all."""
    measure: int = 0
    """Which of the three measures of clearness is used."""
    note: str | None = None
    """A sentence for the user."""


class Spacing(NamedTuple):
    """Which profiles of a laser are neighbours."""

    every: int = 1
    """Number of profiles to the next one that is compared."""
    drift_px: float = _LEAST_DRIFT_PX
    """How far a stripe may move from one to the next [px]."""

    @classmethod
    def of(cls, plan: Plan) -> "Spacing":
        """Far enough apart that the room has moved on."""
        sweep, camera = plan.sweep, plan.scanner.camera
        own = sweep.angles[sweep.record[sweep.laser == sweep.laser[0]]]
        turn = float(np.median(np.abs(np.diff(own)))) if len(own) > 1 else 0.0
        step = turn * float(max(np.asarray(camera.fx), np.asarray(camera.fy)))
        if plan.scanner.turntable.carries not in ("scanner", "object") or step <= 0.0:
            return cls()
        every = int(np.clip(np.ceil(_APART_PX / step), 1, max(1, (len(own) - 1) // (_RUN - 1))))
        return cls(every, max(_LEAST_DRIFT_PX, _DRIFT * every * step))


def clearness(
    stripes: Mapping[str, np.ndarray], sequences: Sequence[np.ndarray], spacing: Spacing
) -> Float[np.ndarray, "profiles lines 3"]:
    """Three measures of how clear a stripe is, 0 for none.

    The part of its neighbours that go on with it [1]: the mean of that of neighbouring profiles on the same line and
    that of all around. Its square times the amplitude [DN]. The square of the part of the neighbouring lines of its
    own profile, times the amplitude [DN].

    Args:
        stripes: Fields u, amplitude and valid [profiles, lines].
        sequences: Numbers of profiles that follow each other as neighbours, int [n] of each sequence.
        spacing: How far a stripe may move between two of them.
    """
    u, valid, amplitude = (np.asarray(stripes[name]) for name in ("u", "valid", "amplitude"))
    found = np.zeros((*valid.shape, 3), np.float32)
    # A Bayer mosaic has most colours on every other line.
    every = next((k for k in (0, 1) if not valid[:, 1 - k :: 2].any()), None)
    lines = np.s_[:] if every is None else np.s_[every::2]
    for own in sequences:
        whole, alone = _that_go_on(u[own][:, lines], valid[own][:, lines], spacing.drift_px, 1 if every is None else 2)
        light = np.maximum(amplitude[own][:, lines], 0.0)
        measures = np.stack([whole, whole**2 * light, alone**2 * light], -1)
        found[own, lines] = np.where(valid[own][:, lines, None], measures, 0.0)
    return found


def _that_go_on(
    u: Float[np.ndarray, "profiles lines"], valid: np.ndarray, drift_px: float, line_step: int
) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the neighbours that go on with each stripe: of all, and of those in its own profile."""
    profiles, lines = valid.shape
    # How many neighbours there are, fewer at the ends, with the stripe itself.
    ahead, beside = (
        np.minimum(np.arange(size), reach) + np.minimum(np.arange(size)[::-1], reach) + 1.0
        for size, reach in ((profiles, _PROFILES), (lines, _LINES))
    )
    counts = np.zeros((3, profiles, lines), np.float32)
    for first in range(0, profiles, _AT_ONCE):
        before, stop = max(first - _PROFILES, 0), min(first + _AT_ONCE, profiles)
        part = slice(before, min(stop + _PROFILES, profiles))
        counts[:, first:stop] = _links(u[part], valid[part], drift_px, line_step)[:, first - before : stop - before]
    own, alone, others = counts
    around = (alone + own + others) / np.maximum(ahead[:, None] * beside - 1.0, 1.0)
    # Something is left of a stripe that is alone: its brightness counts.
    least = lambda share: np.maximum(share, 0.01)
    alone = least(alone / np.maximum(beside - 1.0, 1.0))
    return (least(0.5 * (own / (ahead[:, None] - 1.0) + around)) if profiles > 1 else alone), alone


def _links(
    u: Float[np.ndarray, "profiles lines"], valid: np.ndarray, drift_px: float, line_step: int
) -> Float[np.ndarray, "3 profiles lines"]:
    """Numbers of neighbours that go on with each: on the same line, in the same profile, and elsewhere."""
    profiles, lines = valid.shape
    place = np.where(valid, u, np.inf).astype(np.float32)
    wide = np.pad(place, ((_PROFILES, _PROFILES), (_LINES, _LINES)), constant_values=np.inf)
    own, alone, others = counts = np.zeros((3, profiles, lines), np.float32)

    def goes_on(p: int, k: int) -> np.ndarray:
        other = wide[_PROFILES + p :, _LINES + k :][:profiles, :lines]
        with np.errstate(invalid="ignore"):
            return np.abs(place - other) <= _NOISE_PX + _SLOPE * line_step * abs(k) + drift_px * abs(p)

    for k in range(-_LINES, _LINES + 1):
        if k != 0:
            alone += goes_on(0, k)
        for side in (-1, 1):
            unbroken = valid
            for p in range(1, _PROFILES + 1):
                # Print that repeats itself comes back in a later profile, but is not in all between.
                unbroken = unbroken & goes_on(side * p, k)
                (others if k else own)[...] += unbroken
    return counts


class Decoys(NamedTuple):
    """The decoys of some profiles of a sweep."""

    profile: Int[np.ndarray, " searched"]
    """Which profiles."""
    u: Float[np.ndarray, "searched lines"]
    """Centre [px]."""
    amplitude: Float[np.ndarray, "searched lines"]
    """[DN]; 0 where there is no decoy."""

    @staticmethod
    def joined(parts: "list[Decoys]") -> "Decoys":
        """The decoys of all parts of a sweep."""
        together = Decoys(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
        order = np.argsort(together.profile)
        return Decoys(*(field[order] for field in together))


class DecoyWatch:
    """Searches some profiles of a sweep for decoys while they pass by."""

    def __init__(self, plan: Plan, *, predicted: bool) -> None:
        """Choose the profiles; with `predicted`, the laser-off frames are."""
        lasers, every = np.unique(plan.sweep.laser), Spacing.of(plan).every
        runs = -(-(_RUNS_WITHOUT_OFF if predicted else _RUNS) // len(lasers))
        self._chosen: set[int] = set()
        for laser in lasers:
            own = np.flatnonzero(plan.sweep.laser == laser)
            span = every * (_RUN - 1) + 1
            count = max(1, min(runs, len(own) // span))
            for start in np.linspace(0, max(len(own) - span, 0), count).astype(int):
                self._chosen |= set(own[start : start + span : every].tolist())
        self._lines = plan.lines

    def look(self, batch: Batch, search: Callable[[Batch], ChunkStripes]) -> Decoys:
        """The decoys of the chosen profiles of a batch."""
        rows = [k for k, profile in enumerate(batch.profiles.tolist()) if profile in self._chosen]
        none = np.zeros((0, self._lines), np.float32)
        if batch.off is None or not rows:
            return Decoys(np.zeros(0, int), none, none)
        on, off = (np.asarray(frames)[rows] for frames in (batch.on, batch.off))
        result = search(Batch(batch.profiles[rows], batch.laser, off, on))
        found = chosen_of(result.stripes, result.chosen)
        if len(found.u) != len(rows):
            # Where all candidates of a line are wanted none is judged.
            return Decoys(np.zeros(0, int), none, none)
        u, amplitude = (np.asarray(field, np.float32) for field in (found.u, found.amplitude))
        return Decoys(batch.profiles[rows], u, np.where(np.asarray(found.valid), amplitude, 0.0))


def judge_sweep(plan: Plan, stripes: Mapping[str, np.ndarray], decoys: Decoys) -> tuple[Chance, np.ndarray]:
    """The verdict on a sweep, and which of its stripes are accepted.

    Args:
        plan: Of the whole sweep.
        stripes: Fields u, amplitude and valid [profiles, lines], one stripe of each line.
        decoys: Those of the searched profiles.

    Raises:
        CaptureError: As `judge`.
    """
    valid, laser, spacing = np.asarray(stripes["valid"]), plan.sweep.laser, Spacing.of(plan)
    runs = [
        own[start : start + _RUN]
        for own in (np.flatnonzero(laser[decoys.profile] == one) for one in np.unique(laser))
        for start in range(0, len(own), _RUN)
    ]
    searched = {name: np.asarray(stripes[name])[decoys.profile] for name in ("u", "amplitude", "valid")}
    turned = {"u": decoys.u, "amplitude": decoys.amplitude, "valid": decoys.amplitude > 0}
    both = (clearness(fields, runs, spacing) for fields in (searched, turned))
    chance = judge(*both, per_profile=np.count_nonzero(valid) / len(valid))
    if chance.least == 0.0:
        return chance, valid
    own = [np.flatnonzero(laser == one) for one in np.unique(laser)]
    sequences = [one[start :: spacing.every] for one in own for start in range(min(spacing.every, len(one)))]
    accepted = clearness(stripes, sequences, spacing)[..., chance.measure] >= np.float32(chance.least)
    if np.count_nonzero(accepted) < _PER_PROFILE * len(valid):
        chance = dataclasses.replace(chance, note=_FEW)
    return chance, accepted


_FEW = "the sweep is doubtful: hardly any record shows a stripe, and chance may have found those"


class _Contest(NamedTuple):
    """Stripes against decoys by one measure."""

    stripes: Float[np.ndarray, " n"]
    """Clearness of the stripes, rising."""
    decoys: Float[np.ndarray, " m"]
    """Clearness of the decoys."""
    rate: float
    """Stripes of chance for each decoy [1]."""

    @classmethod
    def of(cls, stripes: np.ndarray, decoys: np.ndarray) -> "_Contest":
        stripes, decoys = (np.sort(values[values > 0]) for values in (stripes, decoys))
        middle = float(np.median(decoys)) if len(decoys) else 0.0
        rate = int(np.count_nonzero(stripes <= middle)) / max(int(np.count_nonzero(decoys <= middle)), 1)
        # Where decoys are clearer than the laser's stripes these are no chance.
        return cls(stripes, decoys, min(rate, _RATE))

    @property
    def chance(self) -> float:
        """Stripes that are chance."""
        return self.rate * len(self.decoys)

    def best(self, share: float) -> tuple[int, float]:
        """Stripes that the lowest threshold with such a share of chance leaves, and the threshold."""
        # From each decoy's clearness on: how many of both are left above it.
        left = len(self.stripes) - np.searchsorted(self.stripes, self.decoys, side="right")
        # Of all thresholds one is taken, so luck has no part in it; one decoy is always allowed.
        above = len(self.decoys) - 1 - np.arange(len(self.decoys))
        good = np.flatnonzero(np.maximum(above - 1, 0) * self.rate <= share * left)
        if not len(good):
            return 0, 0.0
        return int(left[good[0]]), float(np.nextafter(np.float32(self.decoys[good[0]]), np.float32(np.inf)))


def judge(
    stripes: Float[np.ndarray, "profiles lines 3"],
    decoys: Float[np.ndarray, "profiles lines 3"],
    *,
    per_profile: float,
) -> Chance:
    """Compare stripes with the decoys of the same lines.

    Args:
        stripes: Clearness of the stripes.
        decoys: Clearness of the decoys.
        per_profile: Stripes of a profile, on average over the whole sweep.

    Raises:
        CaptureError: If the stripes cannot be told from those of chance.
    """
    contests = [_Contest.of(stripes[..., k], decoys[..., k]) for k in range(stripes.shape[-1])]
    total, chance = len(contests[0].stripes), float(min(one.chance for one in contests))
    clean = chance <= _SHARE * total + _LUCK * np.sqrt(_SHARE * total) + 1.0
    if clean or total + len(contests[0].decoys) < _CERTAIN:
        return Chance(note=_FEW if per_profile < _PER_PROFILE else None)
    doubtful = f"the sweep is doubtful: chance finds {100.0 * chance / max(total, 1):.1f} % of the stripes"
    found = [(*one.best(_SHARE), k) for k, one in enumerate(contests)]
    kept, least, measure = max(found[:2])
    # Where decoys go on as far as stripes can, that they do is no sign of a laser.
    that_go_on, threshold, _ = found[0]
    told = (kept if threshold >= _STANDS else that_go_on) >= _CERTAIN
    if not told:
        kept, least, measure = max(found)
    if told or kept >= _KEPT * total:
        part = f"only the clearest {min(100.0 * kept / total, 100.0):.0f} % of them were kept"
        return Chance(least, measure, f"{doubtful}; {part}, of which it has about one in 500; {_HELPS} would keep more")
    if chance <= _MOST * total:
        return Chance(note=f"{doubtful}, as clear as these; {_HELPS} would tell them apart")
    raise CaptureError(
        f"The stripes of the sweep are not told from chance: {total} lines have one, {len(contests[0].decoys)} "
        f"have one with laser on and off exchanged; check that the laser was lit in the on images; else try {_HELPS}."
    )
