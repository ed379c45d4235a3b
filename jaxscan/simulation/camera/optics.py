"""The lens's blur and the pixels' area: light is spread first, then integrated over pixels.

A stripe drawn by pixel centres, or blurred after it was cut into pixels, locks onto the grid by
up to 0.3 px. So stripes and boards are sampled finer than pixels. Every sample is spread over the
pixels around it by the point-spread function, integrated over each pixel.
"""

import math

import numpy as np


_ROWS = 64
"""Rows that are spread at a time: they stay in the processor's cache."""


def psf_weights(psf_px: float, samples: int) -> np.ndarray:
    """Share of a sample's light that each pixel receives.

    Args:
        psf_px: Standard deviation of the Gaussian point-spread function [px].
        samples: Samples per pixel, at (i + 1/2) / samples - 1/2 of it.

    Returns:
        float32 [2 radius + 1, samples]: the share that goes to the pixel m - radius beside the
        sample's own. Each column has the sum `1 / samples`: light is conserved, and a uniform
        field of value 1 gives 1.
    """
    radius = max(1, math.ceil(4 * psf_px))
    at = (np.arange(samples) + 0.5) / samples - 0.5
    fine = 32
    within = (np.arange(fine) + 0.5) / fine - 0.5
    pixels = np.arange(-radius, radius + 1)
    distance = pixels[:, None, None] + within[None, :, None] - at[None, None, :]
    weights = np.exp(-0.5 * (distance / psf_px) ** 2).sum(1)
    return (weights / weights.sum(0) / samples).astype(np.float32)


def splat(
    values: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    weights_v: np.ndarray,
    weights_u: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Image of samples given for some of the pixels only.

    Args:
        values: [pixels, samples_v * samples_u] light of the samples of each listed pixel.
        rows: Row of each listed pixel.
        columns: Column of each.
        weights_v: `psf_weights` along v, [2 radius + 1, samples_v].
        weights_u: The same along u.
        shape: Height and width of the image.

    Returns:
        float32 [height, width].
    """
    count_v, count_u = weights_v.shape[1], weights_u.shape[1]
    lit = np.flatnonzero(values.any(1))
    if len(lit) == 0:
        return np.zeros(shape, np.float32)
    light, rows, columns = values[lit].reshape(-1, count_v, count_u), rows[lit], columns[lit]
    if count_v > count_u:
        return _splat(light.swapaxes(1, 2), columns, rows, weights_u, weights_v, shape[::-1]).T.copy()
    return _splat(light, rows, columns, weights_v, weights_u, shape)


def _splat(
    light: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    weights_v: np.ndarray,
    weights_u: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """As `splat`, of light [pixels, samples_v, samples_u]: spread along u sample by sample, then along v as pictures.

    Only of those rows and columns that are lit.
    """
    reach_v, reach_u = len(weights_v) // 2, len(weights_u) // 2
    top, left = int(rows.min()), int(columns.min())
    height, width = int(rows.max()) - top + 1, int(columns.max()) - left + 1 + 2 * reach_u
    spread = np.einsum("pij,nj->ipn", light.astype(np.float32), weights_u)
    places = (((rows - top) * width + columns - left)[:, None] + np.arange(len(weights_u))).ravel()
    image = np.zeros((height + 2 * reach_v, width), np.float32)
    for part, shares in zip(spread, weights_v.T, strict=True):
        sums = np.bincount(places, weights=part.ravel(), minlength=height * width)
        plane = sums.astype(np.float32).reshape(height, width)
        for start in range(0, height, _ROWS):
            some = plane[start : start + _ROWS]
            for m, share in enumerate(shares):
                image[start + m : start + m + len(some)] += some * share
    out = np.zeros(shape, np.float32)
    # Light that falls beside the sensor is lost.
    first_row, first_column = max(top - reach_v, 0), max(left - reach_u, 0)
    stop_row, stop_column = min(top + height + reach_v, shape[0]), min(left + width - reach_u, shape[1])
    out[first_row:stop_row, first_column:stop_column] = image[
        first_row - top + reach_v : stop_row - top + reach_v,
        first_column - left + reach_u : stop_column - left + reach_u,
    ]
    return out


def integrate(samples: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Image of a whole block of samples.

    Args:
        samples: float32 [n_u, n_v, rows + 2 radius, columns + 2 radius]: the same sample of all
            pixels lies together.
        weights: `psf_weights` [2 radius + 1, n], with n_u = n_v = n.

    Returns:
        float32 [rows, columns].
    """
    # Weight taps - 1 - k is the share that pixel 0 receives from the pixel k - radius beside it.
    kernel = weights[::-1]
    return _weighted_sum(_weighted_sum(samples, kernel, axis=-1), kernel, axis=-2)


def _weighted_sum(samples: np.ndarray, kernel: np.ndarray, *, axis: int) -> np.ndarray:
    """Sum over taps k and samples m of kernel[k, m] times samples[m] shifted by k along u (-1) or v (-2).

    Plain multiply and add on arrays that fit the cache: a BLAS call here is a product with a
    4 x 7 matrix, and its threads get in the way of those that render other frames.
    """
    size = samples.shape[axis] - len(kernel) + 1
    parts = [samples[..., k : k + size] if axis == -1 else samples[..., k : k + size, :] for k in range(len(kernel))]
    out = np.zeros(parts[0].shape[1:], np.float32)
    product = np.empty_like(out)
    for part, row in zip(parts, kernel, strict=True):
        for sample, weight in zip(part, row, strict=True):
            np.multiply(sample, weight, out=product)
            out += product
    return out


def blur(image: np.ndarray, psf_px: float) -> np.ndarray:
    """A picture sampled at pixel centres, blurred by lens and pixel [..., height, width].

    Good enough for the room in its own light, which is looked at but not measured. Binomial
    passes (a, 1 - 2a, a) of the same variance, psf^2 + 1/12, stand for the Gaussian.
    """
    passes, a = _passes(psf_px)
    for _ in range(passes):
        image = _binomial(_binomial(image, a).swapaxes(-1, -2), a).swapaxes(-1, -2)
    return image


def blurred_part(image: np.ndarray, psf_px: float, rows: slice, columns: slice) -> np.ndarray:
    """Some pixels of `blur`; slices have starts and stops."""
    reach = _passes(psf_px)[0]
    top, left = max(rows.start - reach, 0), max(columns.start - reach, 0)
    done = blur(image[..., top : rows.stop + reach, left : columns.stop + reach], psf_px)
    return done[..., rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]


def _passes(psf_px: float) -> tuple[int, np.float32]:
    """How many binomial passes make a blur, and the share of each that goes to a neighbour."""
    variance = psf_px**2 + 1 / 12
    passes = math.ceil(variance / 0.6)
    return passes, np.float32(variance / passes / 2)


def _binomial(image: np.ndarray, a: np.float32) -> np.ndarray:
    """(a, 1 - 2a, a) down the columns; beyond the border stands the border."""
    out, aside = image * (1 - 2 * a), image * a
    out[..., 1:, :] += aside[..., :-1, :]
    out[..., :-1, :] += aside[..., 1:, :]
    out[..., 0, :] += aside[..., 0, :]
    out[..., -1, :] += aside[..., -1, :]
    return out
