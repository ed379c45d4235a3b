"""How many stripes chance would find: the same search in frames whose difference is turned round.

Noise, texture and motion give as many stripes where laser-on and laser-off frame are exchanged; the laser gives none.
On every line the stripe competes with the decoy, and the decoys that win tell how many stripes are won by chance
(J. E. Elias, S. P. Gygi, Target-decoy search strategy, Nature Methods 4, 2007).
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CaptureError
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import ChunkStripes, FrameStripes, chosen_of


_LOOKS, _LOOKS_WITHOUT_OFF = 8, 16
"""Profiles of a sweep that are searched for decoys."""
_BYTES = 200e6
"""Frames of these profiles that are kept, at most; of large frames fewer are searched."""
_SHARE = 0.0025
"""Decoys among the accepted stripes, at most [1]: half of the false points that are promised, as chance is not fair."""
_LUCK = 2.5
"""Standard deviations by which decoys may be more than expected before they count; one more is always allowed."""
_HOPELESS = 0.25
"""Decoys that win, over stripes that win, from which no threshold is trusted [1]."""
_KEPT = 0.1
"""Part of the stripes that a threshold must leave [1]."""
_CERTAIN = 4.0
"""Standard deviations by which stripes must be more than decoys."""
_PER_PROFILE = 2.0
"""Stripes of a profile, on average over the sweep, below which they may all be chance."""


@dataclass(frozen=True)
class Chance:
    """The verdict of the decoys on the stripes of a sweep."""

    least: float = 0.0
    """Smallest clearness (`clearness`) of a stripe that is believed; 0 for all."""
    note: str | None = None
    """A sentence for the user."""


def clearness(stripes: FrameStripes) -> Float[np.ndarray, "profiles lines"]:
    """Width over the standard deviation of the centre [1], which falls with noise and with misfit; 0 for none."""
    valid, width, sigma = (np.asarray(field) for field in (stripes.valid, stripes.width, stripes.sigma))
    return np.where(valid, width / np.maximum(sigma, 1e-4), 0.0).astype(np.float32)


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
            self.found += int(np.count_nonzero(stripes))
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
    ) -> tuple[Float[np.ndarray, "searched lines"], Float[np.ndarray, "searched lines"]]:
        """Search what is kept for decoys: the clearness [1] of the stripes, and of their decoys."""
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
            none = np.zeros((0, 0), np.float32)
            return none, none
        stripes, decoys = (np.concatenate(parts) for parts in zip(*compared, strict=True))
        return stripes, decoys


def _tolerated(stripes: np.ndarray | int) -> np.ndarray:
    """Decoys that so many stripes may have where their share is as it should be: a few come by luck."""
    expected = _SHARE * np.asarray(stripes, np.float64)
    return np.asarray(expected + _LUCK * np.sqrt(expected) + 1.0)


def judge(
    stripes: Float[np.ndarray, "profiles lines"], decoys: Float[np.ndarray, "profiles lines"], *, per_profile: float
) -> Chance:
    """Compare stripes with the decoys of the same lines.

    Args:
        stripes: Clearness of the stripes [1].
        decoys: Clearness of the decoys [1].
        per_profile: Stripes of a profile, on average over the whole sweep.

    Raises:
        CaptureError: If the stripes are not more, or not clearer, than those of chance.
    """
    won, lost = np.sort(stripes[stripes > decoys]), np.sort(decoys[decoys >= np.maximum(stripes, 1e-9)])
    if len(won) + len(lost) < _CERTAIN**2:
        few = "the sweep is doubtful: hardly any record shows a stripe, and chance may have found those"
        return Chance(note=few if per_profile < _PER_PROFILE else None)
    if len(lost) <= _tolerated(len(won)):
        return Chance()
    # From each decoy's clearness on: how many of both are left above it.
    left, beyond = len(won) - np.searchsorted(won, lost, side="right"), len(lost) - 1 - np.arange(len(lost))
    good = np.flatnonzero((beyond <= _tolerated(left)) & (left >= _KEPT * len(won)))
    evident = len(won) - len(lost) > _CERTAIN * np.sqrt(len(won) + len(lost)) and len(lost) < _HOPELESS * len(won)
    if not evident or len(good) == 0:
        raise CaptureError(
            f"The stripes of the sweep are not told from chance: {len(won)} lines have one, {len(lost)} a clearer one "
            "with laser on and off exchanged; check that the laser was lit in the on images, or take off images."
        )
    kept = left[good[0]] / len(won)
    share = 100.0 * len(lost) / len(won)
    return Chance(
        float(np.nextafter(np.float32(lost[good[0]]), np.float32(np.inf))),
        f"the sweep is doubtful: chance finds {share:.1f} % as many stripes; only the clearer "
        f"{100.0 * kept:.0f} % of them were kept, among which it has about {100 * _SHARE:.2g} %",
    )
