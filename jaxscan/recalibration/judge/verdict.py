"""Has the rig drifted, and with which prior is it solved then?"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner
from jaxscan.recalibration.judge.drift import (
    Bow,
    Explanation,
    Part,
    bow_of,
    bow_variance,
    departure_of,
    describe_move,
    explain,
    held_bow,
    holds_no_scale,
    loosened_prior,
    loosening,
    move_of,
    parts_of,
    without_bow,
)
from jaxscan.recalibration.judge.gain import Compared, compare, scale_slopes, scales_of, with_prior
from jaxscan.recalibration.observed import RecalibrationSettings
from jaxscan.recalibration.result import Adjusted, Drift


Solving = Callable[[Scanner, Adjusted], Adjusted]
"""A solve with a prior, the stored scanner with any covariance, that begins where another ended."""
# While nothing is known of a drift, every part may have moved by this share of its largest move.
_LOOSE = 0.1
# A scale that is known this much better than from the calibration is measured.
_MEASURED = 2.0


class Verdict(NamedTuple):
    """The verdict of an adjustment on the rig, and the prior that follows."""

    drift: Drift
    loosened: Float[np.ndarray, "params params"]
    """Variance that was added to the stored covariance."""
    adjusted: Adjusted
    """With that prior."""
    notes: tuple[str, ...] = ()


def loose(stored: Scanner) -> Scanner:
    """The stored scanner with a covariance by which every part may have moved a little, and sheets may be bowed."""
    every = _LOOSE**2 * loosening(parts_of(stored), stored) + bow_variance(stored)
    return with_covariance(stored, np.asarray(stored.covariance) + every)


def with_covariance(scanner: Scanner, covariance: Float[np.ndarray, "params params"]) -> Scanner:
    """The same scanner with another covariance."""
    return eqx.tree_at(lambda s: s.covariance, scanner, covariance, is_leaf=lambda leaf: leaf is None)


def find_drift(stored: Scanner, free: Adjusted, solve: Solving, settings: RecalibrationSettings) -> Verdict:
    """Tests whether anything moved, and solves with the prior that follows.

    Args:
        stored: The stored scanner with its covariance.
        free: Adjusted to the observations with the prior of `loose`.
        solve: Adjusts it to the observations with a prior.
        settings: With the limit of the test.
    """
    prior = np.asarray(stored.covariance)
    both = compare(np.asarray(free.prior.covariance), np.asarray(free.scanner.covariance))
    compared, step = with_prior(both, free.departure, prior)
    departure = departure_of(compared, step)
    bow = _seen_bow(stored, both, free.departure, settings)
    bowed = np.zeros_like(prior) if bow is None else bow_variance(stored)
    told: tuple[str, ...] = ()
    if bow is not None:
        compared, step = with_prior(both, free.departure, prior + bowed)
        compared = without_bow(compared, held_bow(stored))
        departure = departure_of(compared, step)
        told = (_bow_note(bow),)
    p = departure.p
    drift = Drift(departure.chi2, len(departure.value), p, p < settings.p_drift)
    if not drift.drifted:
        return Verdict(drift, bowed, solve(with_covariance(stored, prior + bowed), free), told)
    found = explain(departure, stored)
    known = bool(scales_of(compared, scale_slopes(free.scanner, free.observations)).factor[0] >= _MEASURED)
    added = bowed + loosened_prior(found, departure, stored, scale_known=known)
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
    return Verdict(drift, added, adjusted, (*told, *_notes(found, known, settings)))


def _seen_bow(
    stored: Scanner, both: Compared, step: Float[np.ndarray, " params"], settings: RecalibrationSettings
) -> Bow | None:
    """Bows of sheets that the stored calibration holds flat, where walls show them beyond chance."""
    at = held_bow(stored)
    if not at:
        return None
    compared, tight = with_prior(both, step, np.asarray(stored.covariance) + bow_variance(stored))
    moved = departure_of(without_bow(compared, at), tight).p < settings.p_drift
    # A part that moved bends walls too, so the bow must show whatever else did.
    found = bow_of(both, step, at) if moved else bow_of(compared, tight, at)
    return found if found.p < settings.p_drift else None


def _bow_note(bow: Bow) -> str:
    both = zip(bow.step, bow.sigma, strict=True)
    sizes = ", ".join(f"{1e3 * value:.2f} ± {1e3 * sigma:.2f}" for value, sigma in both)
    return (
        f"the stored calibration holds the laser sheet flat, but walls show it bowed (b2, b3: {sizes} / 1000, "
        f"p = {bow.p:.1g} for a flat one): that is no drift; it is free now, so free it in the next calibration too"
    )


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


def _notes(found: Explanation, known: bool, settings: RecalibrationSettings) -> tuple[str, ...]:
    told = []
    if found.others:
        names = " or ".join(" and ".join(part.name for part in some) for some in (found.parts, *found.others))
        told.append(f"{names}: these sweeps cannot tell which of them moved; the new covariance covers each")
    if found.p < settings.p_drift:
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
