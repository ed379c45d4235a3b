"""The response of a camera, learned from images of one scene at two exposures."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from jaxscan.stripes.frames.formats import GAMMAS, Response, decode_table


_RANKS = 512
# Codes near black and near white hold offsets and clipping [code].
_DARK, _BRIGHT = 10, 245
_FEWEST_RANKS = 40
# A named curve is taken where it is at most so much worse than the best exponent [ratio], or this good [code].
_AS_GOOD, _GOOD = 1.3, 0.4
# Exposures nearer to one another tell nothing.
_LEAST_RATIO = 1.2


class ExposurePair(NamedTuple):
    """Two images of the same scene."""

    short: UInt8[np.ndarray, "*shape"]
    long: UInt8[np.ndarray, "*shape"]
    ratio: float
    """Exposure of the long one over that of the short one [1]."""


class LearnedResponse(NamedTuple):
    """A response, and how well it explains the images."""

    response: Response
    misfit: float
    """Root mean square difference of the long images from the short ones, brightened [codes]."""
    linear_misfit: float
    """The same for a linear response."""


def learn_response(pairs: Sequence[ExposurePair]) -> LearnedResponse | None:
    r"""Choose the response that makes levels proportional to the exposure.

    The scene stands still, so the histograms suffice: the level at rank $p$ of the long image is that of rank $p$ of
    the short one times the ratio $r$ of the exposures,

    $$f(q_{\mathrm{long}}(p)) = r\,f(q_{\mathrm{short}}(p)),$$

    for the right decoding $f$: linear, sRGB, or a power of the code.

    Args:
        pairs: Images of at least one scene; only ratios of 1.2 or more count.

    Returns:
        The response; None where the images have too few levels between black and white.

    Source: Grossberg and Nayar, Determining the camera response from images: what is knowable? (2003).
    """
    told = [pair for pair in pairs if pair.ratio >= _LEAST_RATIO]
    ranks = [_ranks(pair) for pair in told]
    if sum(len(short) for short, _ in ranks) < _FEWEST_RANKS:
        return None
    sides = [(short, long, pair.ratio) for (short, long), pair in zip(ranks, told, strict=True) if len(short)]
    misfit = lambda response: _misfit(response, sides)
    gammas = [f"gamma {gamma:.2f}" for gamma in np.arange(GAMMAS[0], GAMMAS[1] + 0.005, 0.02)]
    best = min(gammas, key=misfit)
    named = min(("linear", "srgb"), key=misfit)
    chosen = named if misfit(named) <= max(_AS_GOOD * misfit(best), _GOOD) else best
    return LearnedResponse(chosen, misfit(chosen), misfit("linear"))


def _ranks(pair: ExposurePair) -> tuple[np.ndarray, np.ndarray]:
    """Codes of both images at the same ranks, between black and white."""
    share = (np.arange(_RANKS) + 0.5) / _RANKS
    short, long = (_quantiles(image, share) for image in (pair.short, pair.long))
    usable = (short > _DARK) & (short < _BRIGHT) & (long > _DARK) & (long < _BRIGHT)
    return short[usable], long[usable]


def _quantiles(image: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Codes below which these shares of the pixels lie, each code spread evenly over its width [code]."""
    below = np.concatenate([[0.0], np.cumsum(np.bincount(image.ravel(), minlength=256))]) / image.size
    # A code that no pixel has is a flat part of the curve.
    return np.interp(share, below + 1e-9 * np.arange(257), np.arange(257) - 0.5)


def _misfit(response: Response, sides: Sequence[tuple[np.ndarray, np.ndarray, float]]) -> float:
    level, slope = decode_table(response)
    codes = np.arange(256.0)
    error = [
        (np.interp(long, codes, level) - ratio * np.interp(short, codes, level)) / np.interp(long, codes, slope)
        for short, long, ratio in sides
    ]
    return float(np.sqrt(np.mean(np.concatenate(error) ** 2)))
