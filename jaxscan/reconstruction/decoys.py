"""How many stripes chance would find: the same search in frames whose difference is turned round.

Noise, texture and motion give as many stripes where laser-on and laser-off frame are exchanged; the laser gives none.
On every line the stripe competes with the decoy, and the decoys that win tell how many stripes are won by chance
(J. E. Elias, S. P. Gygi, Target-decoy search strategy, Nature Methods 4, 2007). Lines on which no laser falls are won
by either, so their number says nothing about the others: what counts is whether some clearness parts stripes from
decoys. Where it leaves a small part of the stripes, many profiles must show a line that is clearer still.

Thresholds of the verdict, and why:

- `_CERTAIN`, 4 sigma: fewer lines than its square tell nothing; so sure is it that stripes are more than decoys.
- `_FAIR`, 1 in 400, with `_LUCK`, 2.5 sigma, and one more: decoys of a good sweep; with no more of them all is kept.
- `_SHARES`, from 0.1 %: decoys among what is kept, a fifth of the false points that are promised, as bright print is
  commoner than dark print. The larger ones are for sweeps of which less would leave nothing, and are said.
- `_KEPT`, a quarter of the stripes, that must be left: without a laser at most 3 % of a colour camera's are, and 22 %
  of a mono one's, which takes bright print for stripes.
- `_CLEARER`, 1.5: clearness of a line on few rows over that of all decoys but one; without a laser 2 % are so clear.
- `_SHOWN`, 35 % of the searched profiles must show such a line, on `_RUN` of `_WITHIN` rows; without a laser 25 % do.
- `_PER_PROFILE`, 2: stripes of a profile, on average over the sweep, below which they may all be chance.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CaptureError
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import ChunkStripes, FrameStripes, chosen_of


_LOOKS, _LOOKS_WITHOUT_OFF = 8, 16
"""Profiles of a sweep that are searched for decoys."""
_BYTES = 200e6
"""Frames of these profiles that are kept, at most; of large frames fewer are searched."""
_ALONG, _NEXT_LINES, _NEXT_PX = 5, 2, 1.0
"""Rows on either side that may go on with a stripe; how many lines the next one is away at most, and how many pixels
for each of them."""
_PROFILES = 256
"""Profiles looked at together."""
_CERTAIN, _FAIR, _LUCK = 4.0, 0.0025, 2.5
_SHARES, _KEPT = (0.001, 0.01, 0.05), 0.25
_CLEARER, _SHOWN, _RUN, _WITHIN = 1.5, 0.35, 3, 5
_PER_PROFILE = 2.0
_HELPS = "narrower range limits, one dark picture as --off of `jaxscan import`, or the right --laser-colour"


@dataclass(frozen=True)
class Chance:
    """The verdict of the decoys on the stripes of a sweep."""

    least: float = 0.0
    """Smallest clearness (`clearness`) of a stripe that is believed; 0 for all."""
    measure: int = 0
    """Which of the two."""
    note: str | None = None
    """A sentence for the user."""


def clearness(stripes: Mapping[str, np.ndarray] | FrameStripes) -> Float[np.ndarray, "profiles lines 2"]:
    """Two measures of how clear a stripe is, 0 for none: width over the standard deviation of the centre, times the
    square of the part of the rows around that go on with it [1]; and the same times the root of the amplitude [DN].

    Width over sigma falls with noise and misfit; but where speckle is strong it is about the same for all. A laser's
    line goes on from row to row, and what chance finds seldom does.
    """
    fields = stripes._asdict() if isinstance(stripes, FrameStripes) else stripes
    names = ("valid", "u", "width", "sigma", "amplitude")
    valid, u, width, sigma, amplitude = (np.asarray(fields[name]) for name in names)
    found = np.zeros((*valid.shape, 2), np.float32)
    for first in range(0, len(valid), _PROFILES):
        part = slice(first, first + _PROFILES)
        clear = np.where(valid[part], width[part] / np.maximum(sigma[part], 1e-4), 0.0)
        clear = clear * ((1.0 + _that_go_on(u[part], valid[part])) / (1.0 + 2.0 * _ALONG)) ** 2
        found[part, :, 0], found[part, :, 1] = clear, clear * np.sqrt(np.maximum(amplitude[part], 0.0))
    return found


def _that_go_on(u: Float[np.ndarray, "profiles lines"], valid: np.ndarray) -> np.ndarray:
    """How many of the rows on both sides of each go on with its stripe, without a break."""
    # Those that have a stripe, one after the other.
    line = np.argsort(~valid, axis=1, kind="stable")
    there, centre = (np.take_along_axis(field, line, 1) for field in (valid, u))
    lines = np.diff(line, axis=1)
    goes_on = there[:, 1:] & (lines <= _NEXT_LINES) & (np.abs(np.diff(centre, axis=1)) < _NEXT_PX * lines)
    beyond = np.pad(goes_on, ((0, 0), (_ALONG, _ALONG)))
    count, rows = np.zeros(valid.shape, np.float32), valid.shape[1]
    before, after = (there.copy() for _ in range(2))
    for k in range(1, _ALONG + 1):
        before &= beyond[:, _ALONG - k : _ALONG - k + rows]
        after &= beyond[:, _ALONG + k - 1 : _ALONG + k - 1 + rows]
        count += before
        count += after
    np.put_along_axis(found := np.zeros_like(count), line, count, 1)
    return found


class DecoyWatch:
    """Keeps some pairs of a sweep while they pass by, and searches them for decoys at the end."""

    def __init__(self, profiles: int, *, predicted: bool, first: int = 0) -> None:
        """
        Args:
            profiles: Of the sweep.
            predicted: Whether the laser-off frames are predicted.
            first: Where a part of the sweep is watched, the number of profiles before it.
        """
        looks = _LOOKS_WITHOUT_OFF if predicted else _LOOKS
        self._chosen = set((np.unique(np.linspace(0, profiles - 1, min(looks, profiles)).astype(int)) - first).tolist())
        self._kept: list[tuple[Batch, np.ndarray]] = []
        self._profiles, self.found = profiles, 0
        self._bytes, self._lock = 0, threading.Lock()

    def look(self, batch: Batch, found: ChunkStripes) -> None:
        """Keep the chosen ones of a batch, to be searched for decoys; in threads and in any order."""
        stripes = clearness(chosen_of(found.stripes, found.chosen))
        with self._lock:
            self.found += int(np.count_nonzero(stripes[..., 0]))
        rows = [k for k, profile in enumerate(batch.profiles.tolist()) if profile in self._chosen]
        if batch.off is None or not rows or len(stripes) != len(batch.on):
            return
        with self._lock:
            each = 2 * batch.on[0].nbytes
            rows = rows[: max(int((_BYTES - self._bytes) // each), 0 if self._bytes else 1)]
            self._bytes += each * len(rows)
            if rows:
                on, off = (np.asarray(frames)[rows] for frames in (batch.on, batch.off))
                self._kept.append((Batch(batch.profiles[rows], batch.laser, on, off), stripes[rows]))

    def compared(
        self, search: Callable[[Batch], ChunkStripes], size: int
    ) -> tuple[Float[np.ndarray, "searched lines 2"], Float[np.ndarray, "searched lines 2"]]:
        """Search what is kept for decoys: the clearness of the stripes, and of their decoys."""
        compared: list[tuple[np.ndarray, np.ndarray]] = []
        for laser in sorted({batch.laser for batch, _ in self._kept}):
            own = [item for item in self._kept if item[0].laser == laser]
            profiles, on, off, found = (
                np.concatenate(parts)
                for parts in zip(*((b.profiles, np.asarray(b.on), np.asarray(b.off), s) for b, s in own), strict=True)
            )
            for start in range(0, len(profiles), size):
                part = slice(start, start + size)
                result = search(Batch(profiles[part], laser, off[part], on[part]))
                compared.append((found[part], clearness(chosen_of(result.stripes, result.chosen))))
        self._kept = []
        if not compared:
            none = np.zeros((0, 0, 2), np.float32)
            return none, none
        stripes, decoys = (np.concatenate(parts) for parts in zip(*compared, strict=True))
        return stripes, decoys


class _Contest(NamedTuple):
    """Stripes against decoys by one measure."""

    won: Float[np.ndarray, " n"]
    """Clearness of the stripes that win their line, rising."""
    lost: Float[np.ndarray, " m"]
    """That of the decoys that do."""

    @classmethod
    def of(cls, stripes: np.ndarray, decoys: np.ndarray) -> "_Contest":
        return cls(np.sort(stripes[stripes > decoys]), np.sort(decoys[decoys >= np.maximum(stripes, 1e-9)]))

    def best(self, share: float) -> tuple[int, float]:
        """Stripes that the lowest threshold with such a share of decoys leaves, and the threshold."""
        # From each decoy's clearness on: how many of both are left above it.
        left = len(self.won) - np.searchsorted(self.won, self.lost, side="right")
        # Of all thresholds one is taken, so luck has no part in it; one decoy is always allowed.
        good = np.flatnonzero(len(self.lost) - 1 - np.arange(len(self.lost)) <= share * left + 1.0)
        if not len(good):
            return 0, 0.0
        return int(left[good[0]]), float(np.nextafter(np.float32(self.lost[good[0]]), np.float32(np.inf)))


def _clear_lines(
    stripes: Float[np.ndarray, "profiles lines measures"],
    decoys: Float[np.ndarray, "profiles lines measures"],
    contests: list[_Contest],
) -> tuple[int, float, int] | None:
    """Stripes that are clearer by half than decoys, the threshold, and by which measure; None where not enough profiles
    have several in neighbouring rows."""
    found = []
    for measure, contest in enumerate(contests):
        least, own = _CLEARER * contest.best(0.0)[1], stripes[..., measure]
        kept = (own > decoys[..., measure]) & (own >= least) & (least > 0.0)
        rows = np.lib.stride_tricks.sliding_window_view(kept, min(_WITHIN, kept.shape[1]), axis=1)
        profiles = np.count_nonzero((np.count_nonzero(rows, axis=-1) >= _RUN).any(1))
        if profiles >= _SHOWN * len(kept):
            found.append((int(np.count_nonzero(kept)), float(least), measure))
    return max(found, default=None)


def judge(
    stripes: Float[np.ndarray, "profiles lines 2"],
    decoys: Float[np.ndarray, "profiles lines 2"],
    *,
    per_profile: float,
) -> Chance:
    """Compare stripes with the decoys of the same lines.

    Args:
        stripes: Clearness of the stripes.
        decoys: Clearness of the decoys.
        per_profile: Stripes of a profile, on average over the whole sweep.

    Raises:
        CaptureError: If the stripes are not more than those of chance, no threshold parts them, and no clear line is
            shown by several profiles.
    """
    contests = [_Contest.of(stripes[..., k], decoys[..., k]) for k in range(stripes.shape[-1])]
    won, lost = min(((len(one.won), len(one.lost)) for one in contests), key=lambda both: both[1])
    if won + lost < _CERTAIN**2:
        few = "the sweep is doubtful: hardly any record shows a stripe, and chance may have found those"
        return Chance(note=few if per_profile < _PER_PROFILE else None)
    if lost <= _FAIR * won + _LUCK * np.sqrt(_FAIR * won) + 1.0:
        return Chance()
    doubtful = f"the sweep is doubtful: chance finds {100.0 * lost / max(won, 1):.1f} % as many stripes"
    kept_alone = lambda kept: f"{doubtful}; only the clearest {min(100.0 * kept / won, 100.0):.0f} % of them were kept"
    if won - lost > _CERTAIN * np.sqrt(won + lost):
        for share in _SHARES:
            kept, least, measure = max((*one.best(share), k) for k, one in enumerate(contests))
            if kept >= _KEPT * won:
                among = f"among which it has about {100 * share:.2g} %"
                return Chance(least, measure, f"{kept_alone(kept)}, {among}; {_HELPS} would keep more")
    shown = _clear_lines(stripes, decoys, contests)
    if shown is not None:
        kept, least, measure = shown
        return Chance(least, measure, f"{kept_alone(kept)}, clearer by half than those; {_HELPS} would keep more")
    if lost <= _SHARES[-1] * won:
        return Chance(note=f"{doubtful}, as clear as these; {_HELPS} would tell them apart")
    raise CaptureError(
        f"The stripes of the sweep are not told from chance: {won} lines have one, {lost} a clearer one with laser on "
        f"and off exchanged; check that the laser was lit in the on images; else try {_HELPS}."
    )
