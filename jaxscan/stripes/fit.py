"""Maximum-likelihood fit of a pixel-integrated Gaussian to the samples around a candidate.

All arrays have the window's samples first and the rows last: every operation is then one long
vector over rows, and sums over the window need no shuffling.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from jaxscan.geometry import Array


UNUSED = 1e30
"""Variance of a sample that does not count [DN^2]."""
MIN_WIDTH_PX = 0.3
"""Below this the width of a stripe cannot be told from its pixel's [px]."""


class Window(NamedTuple):
    """Samples around a candidate, coordinates relative to the window's middle."""

    x: Float[Array, "samples rows"]
    """Centre of a sample [px]."""
    y: Float[Array, "samples rows"]
    """Level: on minus off, or on where there is no off [DN]."""
    variance: Float[Array, "samples rows"]
    """Variance of `y` but for the stripe's own shot noise [DN^2]; UNUSED where the sample is
    outside the image, far from the candidate or saturated."""
    aperture: Float[Array, " rows"]
    """Length over which a sample integrates [px]."""
    shot: Float[Array, " rows"]
    """Variance of `y` per DN of stripe [DN]."""


class Start(NamedTuple):
    """Where the fit starts."""

    u: Float[Array, " rows"]
    """Centre, from the window's middle [px]."""
    amplitude: Float[Array, " rows"]
    """Amplitude [DN]."""
    width: Float[Array, " rows"]
    """Standard deviation [px]."""
    background: Float[Array, " rows"] | None
    """Background [DN]; None where it is known to be 0."""


class Fit(NamedTuple):
    """Result of the fit; `u` relative to the window's middle."""

    u: Float[Array, " rows"]
    amplitude: Float[Array, " rows"]
    width: Float[Array, " rows"]
    variance: Float[Array, " rows"]
    """Variance of `u` with all other parameters unknown [px^2]; 0 where it is not determined."""
    chi2: Float[Array, " rows"]
    """Chi-squared of all used samples."""
    energy: Float[Array, " rows"]
    """Squared signal-to-noise ratio of the stripe: sum of model^2 / variance."""
    samples: Float[Array, " rows"]
    """Number of used samples."""
    last_step: Float[Array, " rows"]
    """Size of the last step in `u` [px]."""


def integrated_gaussian(
    x: Float[Array, "samples rows"], width: Float[Array, " rows"], aperture: Float[Array, " rows"]
) -> tuple[Float[Array, "samples rows"], Float[Array, "samples rows"], Float[Array, "samples rows"]]:
    r"""Mean of a unit Gaussian over a sample, and its derivatives.

    With $z = x/w$, $q = (a/w)^2$ for the aperture a, and Hermite polynomials $He_n$,

    $$h = e^{-z^2/2} (1 + q He_2(z) / 24 + q^2 He_4(z) / 1920)$$

    is the Taylor series of the integral. What is left out is below 5e-5 for w = a, 4e-4 for
    w = 0.7 a and 3e-3 for w = a/2, and even in x, so that it hardly moves the centre.

    Args:
        x: Centre of the sample from the Gaussian's centre [px].
        width: Standard deviation [px].
        aperture: Length over which a sample integrates [px].

    Returns:
        h: Mean over the sample [1].
        minus_slope: -dh/dx, the derivative by the Gaussian's centre [1/px].
        by_width: dh/dw [1/px].
    """
    per_width = 1.0 / width
    z = x * per_width[None, :]
    s = z * z
    q = (aperture * per_width) ** 2
    c1, c2 = (q / 24)[None, :], (q**2 / 1920)[None, :]
    gauss = jnp.exp(-0.5 * s)
    # Every derivative of a Gaussian is the next Hermite polynomial.
    h = gauss * (1.0 + c1 * (s - 1.0) + c2 * ((s - 6.0) * s + 3.0))
    minus_slope = gauss * (z * per_width[None, :]) * (1.0 + c1 * (s - 3.0) + c2 * ((s - 10.0) * s + 15.0))
    # w dh/dw = h + w^2 d^2h/dx^2: the heat equation, and the norm that grows with w.
    second = (s - 1.0) + c1 * ((s - 6.0) * s + 3.0) + c2 * (((s - 15.0) * s + 45.0) * s - 15.0)
    by_width = (h + gauss * second) * per_width[None, :]
    return h, minus_slope, by_width


def fit_stripe(
    window: Window, start: Start, *, iterations: int, max_width: float, min_snr: float = 0.0, rest: float = 0.0
) -> Fit:
    r"""Fit centre, amplitude and width (and a constant background) of one stripe per row.

    Scoring: every step solves the weighted normal equations with weights
    $1 / (\mathrm{variance} + \mathrm{shot} \cdot \max(F, 0))$ from the present model F, which
    converges to the maximum of the likelihood; the normal matrix is then its information.

    Args:
        window: The samples.
        start: Where to start; with a background where that is to be fitted too.
        iterations: Largest number of steps, the same for all rows.
        max_width: Largest width that a step may reach [px].
        min_snr: Signal-to-noise ratio from which a row's steps are waited for [1].
        rest: Error of the centre, in its standard deviations, with which the steps may end
            before `iterations`: what a step leaves is about its size times the relative change
            of the parameters.

    Source:
        S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
        section 7.7 (scoring); equation 3.31 (information of a signal in Gaussian noise).
    """
    free = start.background is not None
    base = jnp.zeros_like(start.u) if start.background is None else start.background

    def step(state):
        number, moving, u, amplitude, width, base, _ = state
        h, slope, by_width = integrated_gaussian(window.x - u[None, :], width, window.aperture)
        model = amplitude[None, :] * h
        whiten = lax.rsqrt(window.variance + window.shot[None, :] * jnp.maximum(model, 0.0))
        residual = whiten * (window.y - model - base[None, :])
        # The centre last: its pivot is then the information that is left to it. Its column and
        # the width's are per amplitude, so their steps are amplitude times centre and width.
        jacobian = [whiten * h, whiten * by_width, whiten * slope]
        if free:
            jacobian.insert(0, whiten)
        normal = [[jnp.sum(a * b, 0) for b in jacobian[: i + 1]] for i, a in enumerate(jacobian)]
        gradient = [jnp.sum(a * residual, 0) for a in jacobian]
        delta, information = _solve(normal, gradient)
        gain = sum(d * g for d, g in zip(delta, gradient, strict=True))
        chi2 = jnp.maximum(jnp.sum(residual * residual, 0) - gain, 0.0)
        by_u, by_w, reach = delta[-1] / amplitude, delta[-2] / amplitude, jnp.maximum(width, 1.0)
        taller = jnp.clip(amplitude + delta[-3], 0.3 * amplitude, 3.0 * amplitude)
        # By the new amplitude: the first one is the highest sample, which in noise is too high.
        information, energy = taller * taller * information, taller * taller * normal[-3][-1]
        change = (jnp.abs(by_u) + jnp.abs(by_w)) / width + jnp.abs(delta[-3]) / amplitude
        left = by_u * change
        # What still does not stand out of the noise after two steps is not waited for.
        hopeful = (number < 1) | (energy >= (0.8 * min_snr) ** 2)
        after = (
            moving & (left * left * information > rest**2) & hopeful,
            u + jnp.clip(by_u, -reach, reach),
            taller,
            jnp.clip(width + jnp.clip(by_w, -0.4 * width, 0.6 * width), MIN_WIDTH_PX, max_width),
            base + delta[0] if free else base,
            (information, energy, chi2, by_u),
        )
        # A row at rest stays as it is, so that no row depends on its neighbours.
        return number + 1, *jax.tree.map(lambda new, old: jnp.where(moving, new, old), after, state[1:])

    none = jnp.zeros_like(start.u)
    everywhere = jnp.ones(start.u.shape, jnp.bool_)
    first = (jnp.int32(0), everywhere, start.u, start.amplitude, start.width, base, (none,) * 4)
    _, _, u, amplitude, width, _, summary = lax.while_loop(
        lambda state: (state[0] < iterations) & jnp.any(state[1]), step, first
    )
    information, energy, chi2, last = summary
    determined = information > 0
    return Fit(
        u=u,
        amplitude=amplitude,
        width=width,
        variance=jnp.where(determined, 1.0 / jnp.where(determined, information, 1.0), 0.0),
        chi2=chi2,
        energy=energy,
        samples=jnp.sum((window.variance < UNUSED).astype(u.dtype), 0),
        last_step=jnp.abs(last),
    )


def sharpen(window: Window, start: Start) -> Start:
    r"""A better start where no background is unknown: moments under a Gaussian weight.

    The product of two Gaussians is one: from the mean and variance of the samples times a
    Gaussian of centre $u_0$ and width $w_0$ follow centre and width of the samples,

    $$1/w^2 = 1/v - 1/w_0^2, \qquad u = w^2 (m/v - u_0/w_0^2).$$

    Args:
        window: The samples; of a row with clipped ones the moments say nothing.
        start: Centre and width of the weight.
    """
    x = window.x - start.u[None, :]
    weight = jnp.where(window.variance < UNUSED, jnp.exp(-0.5 * (x / start.width[None, :]) ** 2), 0.0)
    moment = weight * window.y
    first = x * moment
    total = jnp.maximum(jnp.sum(moment, 0), 1e-3)
    mean = jnp.sum(first, 0) / total
    square = start.width * start.width
    variance = jnp.clip(jnp.sum(x * first, 0) / total - mean * mean, 0.25 * square, 0.8 * square)
    found = variance * square / (square - variance)
    shift = jnp.clip(found * mean / variance, -start.width, start.width)
    # The weight sees the Gaussian after its integration over a sample.
    width = jnp.sqrt(jnp.maximum(found - window.aperture**2 / 12, 0.25 * square))
    return Start(start.u + shift, start.amplitude, width, start.background)


def _solve(
    normal: Sequence[Sequence[Float[Array, " rows"]]], gradient: Sequence[Float[Array, " rows"]]
) -> tuple[list[Float[Array, " rows"]], Float[Array, " rows"]]:
    """Solve the normal equations of every row, lower triangle given.

    Returns:
        step: One array per parameter.
        information: Pivot of the last parameter, its information with the others unknown.
    """
    size = len(gradient)
    lower: list[list] = [[None] * size for _ in range(size)]
    pivots: list = []
    forward: list = []
    for i in range(size):
        for j in range(i):
            lower[i][j] = (normal[i][j] - sum(lower[i][k] * lower[j][k] * pivots[k] for k in range(j))) / pivots[j]
        pivot = normal[i][i] - sum(lower[i][k] ** 2 * pivots[k] for k in range(i))
        # A row without information stays where it is: a harmless pivot instead of a zero.
        pivots.append(jnp.maximum(pivot, 1e-6 * normal[i][i] + 1e-12))
        forward.append(gradient[i] - sum(lower[i][k] * forward[k] for k in range(i)))
    step: list = [None] * size
    for i in reversed(range(size)):
        step[i] = forward[i] / pivots[i] - sum(lower[k][i] * step[k] for k in range(i + 1, size))
    return step, pivots[-1]
