"""Records that do not continue their neighbours, and how they are named."""

from collections.abc import Iterable, Sequence

import numpy as np


_LISTED = 5


def named(numbers: Sequence[int] | np.ndarray) -> str:
    """ "record 3", or "records 3, 4 and 7"; long lists are cut."""
    texts = [str(int(number)) for number in numbers]
    if len(texts) > _LISTED:
        texts = [*texts[:_LISTED], f"{len(texts) - _LISTED} more"]
    listed = texts[0] if len(texts) == 1 else ", ".join(texts[:-1]) + " and " + texts[-1]
    return f"{'record' if len(texts) == 1 else 'records'} {listed}"


def said(numbers: Sequence[int] | np.ndarray, of_one: str, of_many: str) -> str:
    """Records with their verb: "record 3 shows", or "records 3, 4 and 7 show"."""
    return f"{named(numbers)} {of_one if len(numbers) == 1 else of_many}"


def scatter(residuals: np.ndarray) -> float:
    """Size that four of five residuals keep, so that a few that are wrong do not matter."""
    return float(np.quantile(np.abs(residuals), 0.8)) if len(residuals) else 0.0


def bend(values: np.ndarray) -> np.ndarray:
    """Each value minus the mean of its two neighbours; at the ends minus the one neighbour."""
    if len(values) < 2:
        return np.zeros(len(values))
    padded = np.concatenate([values[1:2], values, values[-2:-1]])
    return values - (padded[:-2] + padded[2:]) / 2


def peaks(sizes: np.ndarray, limit: float) -> np.ndarray:
    """Where a size is over the limit and larger than those of its neighbours, to which a wrong value spreads."""
    padded = np.concatenate([[0.0], sizes, [0.0]])
    return np.flatnonzero((sizes > limit) & (sizes >= 1.2 * padded[:-2]) & (sizes >= 1.2 * padded[2:]))


def groups_of(lit: Sequence[tuple[int, ...]]) -> Iterable[np.ndarray]:
    """Positions of the records with the same lasers lit, ascending."""
    for lasers in sorted(set(lit)):
        yield np.array([k for k, one in enumerate(lit) if one == lasers])
