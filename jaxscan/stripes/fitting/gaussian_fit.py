r"""Maximum-likelihood fit of a pixel-integrated Gaussian to the samples around a candidate.

A Gaussian of width w that is averaged over a pixel of length a has the variance
$w^2 + a^2 / 12$, no skewness, and the fourth cumulant $-a^4 / 120$. The fit therefore knows a
Gaussian of the widened variance with a small correction, and gives back w; the neglected terms are
of sixth order in a / w.

All derivatives of a Gaussian are the Gaussian times powers of x. Every sum that the normal
equations need is thus one of a few moments over the samples, and as the samples lie on the same
lattice in every window, all moments together are one product with a constant matrix. The arrays
have the samples first and the candidates last: every other operation is one long vector.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array


UNUSED_VARIANCE = 1e30
"""Variance of a sample that does not count [DN^2]."""
MIN_WIDTH_PX = 0.3
"""Below this the width of a stripe cannot be told from its pixel's [px]."""
SMALL_STEP = 0.3
"""Relative change of amplitude and width up to which a step is taken as it is [1]."""
SMALLEST = 0.25
"""Smallest squared width of a fit, the pixel's own 1/12 and a little for the stripe [samples^2]."""


class Window(NamedTuple):
    """Samples around a candidate."""

    y: Float[Array, "samples stripes"]
    """Level: on minus off, or on where there is no off [DN]."""
    variance: Float[Array, "samples stripes"]
    """Variance of `y` but for the stripe's own shot noise [DN^2]; UNUSED_VARIANCE where the sample
    does not count."""
    step: Float[Array, " stripes"]
    """Distance between samples [px]."""
    aperture: Float[Array, " stripes"]
    """Length over which a sample integrates [px]."""
    shot: Float[Array, " stripes"]
    """Variance of `y` per DN of stripe [DN]."""


class Start(NamedTuple):
    """Where the fit starts."""

    u: Float[Array, " stripes"]
    """Centre, from the window's middle [px]."""
    amplitude: Float[Array, " stripes"]
    """Amplitude [DN]."""
    width: Float[Array, " stripes"]
    """Standard deviation [px]."""
    background: Float[Array, " stripes"] | None
    """Background [DN]; None where it is known to be 0."""


class FitRules(NamedTuple):
    """When a fit ends, and its prior of the stripe."""

    max_width: float
    """Largest width that a step may reach [px]."""
    prior: tuple[Float[Array, ""], Float[Array, ""]] | None = None
    """Mean of the logarithm of the widened width [px], and its information; None where nothing is known."""
    speckle: Float[Array, "#stripes"] | float = 0.0
    """Contrast of the laser's speckle within a sample [1]."""
    min_snr: float = 0.0
    """Signal-to-noise ratio from which a candidate's steps are waited for [1]."""
    rest: float = 0.0
    """Error of the centre, in its standard deviations, with which the steps may end early: after a step
    about its size times the relative change of the parameters is left."""


class Fit(NamedTuple):
    """Result of the fit; `u` relative to the window's middle."""

    u: Float[Array, " stripes"]
    amplitude: Float[Array, " stripes"]
    """Peak of the Gaussian before its integration over a sample [DN]."""
    width: Float[Array, " stripes"]
    variance: Float[Array, " stripes"]
    """Variance of `u` with all other parameters unknown [px^2]; 0 where it is not determined."""
    chi2: Float[Array, " stripes"]
    """Chi-squared of all used samples."""
    skew: Float[Array, " stripes"]
    """Skewness that the residuals speak of: that of a Gram-Charlier series [1]."""
    energy: Float[Array, " stripes"]
    """Squared signal-to-noise ratio of the stripe: sum of model^2 / variance, without speckle."""
    samples: Float[Array, " stripes"]
    """Number of used samples."""
    last_step: Float[Array, " stripes"]
    """Size of the last step in `u` [px]."""


def sample_places(samples: int) -> Float[np.ndarray, " samples"]:
    """Where a window's samples lie, from its middle, in samples."""
    return (np.arange(samples) - 0.5 * (samples - 1)).astype(np.float32)


def fit_stripe(
    window: Window,
    start: Start,
    rules: FitRules,
    *,
    iterations: int | Int[Array, " stripes"],
    active: Bool[Array, " stripes"] | None = None,
) -> Fit:
    r"""Fit centre, amplitude and width (and a constant background) of every candidate.

    Scoring: every step solves the weighted normal equations with weights
    $1 / (\mathrm{variance} + \mathrm{shot} \cdot \max(F, 0) + (\mathrm{speckle} \cdot F)^2)$ from the
    present model F, which converges to the maximum of the likelihood; the normal matrix is then
    its information.

    Args:
        window: The samples.
        start: Where to start; with a background where that is to be fitted too.
        rules: The prior of the width, and when the steps end.
        iterations: Largest number of steps, of all or of each.
        active: Which candidates are real; all where not given.

    Source:
        S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
        section 7.7 (scoring); equation 3.31 (information of a signal in Gaussian noise).
    """
    dtype = window.y.dtype
    place = jnp.asarray(sample_places(window.y.shape[0]), dtype)
    powers = jnp.stack([place**k for k in range(7)])
    free = start.background is not None
    base = jnp.zeros_like(start.u) if start.background is None else start.background
    pixel = (window.aperture / window.step) ** 2 / 12
    prior, speckle = rules.prior, jnp.atleast_1d(jnp.asarray(rules.speckle, dtype))
    widest = rules.max_width / window.step
    log_step = jnp.log(window.step)

    def step(state):
        number, moving, u, amplitude, squared, base, _ = state
        distance = place[:, None] - u[None, :]
        s = distance * distance * (1.0 / squared)[None, :]
        gauss = jnp.exp(-0.5 * s)
        # The fourth cumulant of the pixel, by the Hermite polynomial that belongs to it.
        flatness = -0.05 * pixel * pixel / (squared * squared)
        model = amplitude[None, :] * gauss * (1.0 + flatness[None, :] * ((s - 6.0) * s + 3.0))
        bright = jnp.maximum(model, 0.0)
        spread = window.variance + window.shot[None, :] * bright
        grain = speckle[None, :] * bright
        total = spread + grain * grain
        # One division for both.
        per_both = 1.0 / (spread * total)
        weight = spread * per_both
        residual = window.y - model - base[None, :]
        weighted = weight * gauss
        about = _about(powers @ (weighted * gauss), u, squared)
        first = _about(powers[:4] @ (weighted * residual), u, squared)
        # Parameters: amplitude, width and centre, the last two relative to the width. The centre
        # last: its pivot is then the information that is left to it.
        normal = [[about[0]], [about[2], about[4]], [about[1], about[3], about[2]]]
        gradient = [first[0], first[2], first[1]]
        if prior is not None:
            # The parameters are per amplitude.
            per_amplitude = prior[1] / amplitude
            missing = prior[0] - 0.5 * jnp.log(squared) - log_step
            normal[1] = [normal[1][0], normal[1][1] + per_amplitude / amplitude]
            gradient[1] = gradient[1] + per_amplitude * missing
        if free:
            plain = _about(powers[:3] @ weighted, u, squared)
            normal = [[powers[0] @ weight], [plain[0], *normal[0]], [plain[2], *normal[1]], [plain[1], *normal[2]]]
            gradient.insert(0, powers[0] @ (weight * residual))
        delta, pivot = _solve(normal, gradient)
        explained = sum(d * g for d, g in zip(delta, gradient, strict=True))
        chi2 = jnp.maximum(powers[0] @ (weight * residual * residual) - explained, 0.0)
        width = jnp.sqrt(squared)
        by_u, by_w = delta[-1] / amplitude, delta[-2] / amplitude
        # Large steps in log amplitude and 1 / width^2, in which the logarithm of a Gaussian is linear:
        # where the top is clipped, steps in amplitude and width would overshoot again and again.
        by_a = jnp.clip(delta[-3] / amplitude, -1.2, 1.2)
        small = jnp.abs(by_a) + jnp.abs(by_w) < SMALL_STEP
        taller = amplitude * jnp.where(small, 1.0 + by_a, jnp.exp(by_a))
        # By the new amplitude: the first one is the highest sample, which in noise is too high.
        information = taller * taller * pivot
        # Where there is no stripe there is no speckle either.
        energy = taller * taller * (powers[0] @ (total * per_both * gauss * gauss))
        change = jnp.abs(by_u) + jnp.abs(by_w) + jnp.abs(delta[-3]) / amplitude
        left = by_u * change
        # A candidate that does not stand out of the noise after two steps is given up.
        hopeful = (number < 1) | (energy >= (0.8 * rules.min_snr) ** 2)
        # The third Hermite polynomial without the part that a shift of the centre explains.
        shifted = (about[4] - 3.0 * about[2]) ** 2 / jnp.maximum(about[2], 1e-12)
        cubic = about[6] - 6.0 * about[4] + 9.0 * about[2] - shifted
        skew = 6.0 * (first[3] - 3.0 * first[1]) / jnp.maximum(amplitude * cubic, 1e-12)
        limit = jnp.maximum(1.0, 1.0 / width)
        wider = squared * jnp.where(small, (1.0 + by_w) ** 2, 1.0 / (1.0 - 2.0 * jnp.clip(by_w, -0.8, 0.3)))
        after = (
            # One step alone would leave a wrong chi-squared.
            moving & (number + 1 < iterations) & ((number < 1) | (left * left * information > rules.rest**2)) & hopeful,
            u + width * jnp.clip(by_u, -limit, limit),
            taller,
            jnp.clip(wider, SMALLEST, widest * widest + pixel),
            base + delta[0] if free else base,
            (information / squared, energy, chi2, skew, width * by_u),
        )
        # A candidate at rest stays as it is, so that none depends on its neighbours.
        return number + 1, *jax.tree.map(lambda new, old: jnp.where(moving, new, old), after, state[1:])

    none = jnp.zeros_like(start.u)
    moving = jnp.ones(start.u.shape, jnp.bool_) if active is None else active
    squared = jnp.clip((start.width / window.step) ** 2 + pixel, SMALLEST, widest * widest + pixel)
    # Integration over a pixel keeps the area.
    lower = start.amplitude * start.width / window.step / jnp.sqrt(squared)
    first = (jnp.int32(0), moving, start.u / window.step, lower, squared, base, (none,) * 5)
    # GPUs may multiply float32 matrices with 10 bits otherwise.
    with jax.default_matmul_precision("highest"):
        _, _, u, amplitude, squared, _, summary = lax.while_loop(lambda state: jnp.any(state[1]), step, first)
    information, energy, chi2, skew, last = summary
    determined = information > 0
    per_step = window.step * window.step
    width = jnp.sqrt(jnp.maximum(squared - pixel, (MIN_WIDTH_PX / window.step) ** 2))
    return Fit(
        u=u * window.step,
        amplitude=amplitude * jnp.sqrt(squared) / width,
        width=width * window.step,
        variance=jnp.where(determined, per_step / jnp.where(determined, information, 1.0), 0.0),
        chi2=chi2,
        skew=skew,
        energy=energy,
        samples=jnp.sum((window.variance < UNUSED_VARIANCE).astype(dtype), 0),
        last_step=jnp.abs(last) * window.step,
    )


def _about(
    moments: Float[Array, "powers stripes"], u: Float[Array, " stripes"], squared: Float[Array, " stripes"]
) -> list[Float[Array, " stripes"]]:
    """Moments about the window's middle to moments about `u`, in units of the width."""
    per_width = lax.rsqrt(squared)
    current = [moments[k] for k in range(moments.shape[0])]
    # Horner's scheme, as for the coefficients of a shifted polynomial.
    for done in range(1, len(current)):
        for k in range(len(current) - 1, done - 1, -1):
            current[k] = current[k] - u * current[k - 1]
    scale = jnp.ones_like(u)
    for k in range(1, len(current)):
        scale = scale * per_width
        current[k] = current[k] * scale
    return current


def _solve(
    normal: Sequence[Sequence[Float[Array, " stripes"]]], gradient: Sequence[Float[Array, " stripes"]]
) -> tuple[list[Float[Array, " stripes"]], Float[Array, " stripes"]]:
    """Solve the normal equations of every candidate, lower triangle given.

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
        # A candidate without information stays where it is: a harmless pivot instead of a zero.
        pivots.append(jnp.maximum(pivot, 1e-6 * normal[i][i] + 1e-12))
        forward.append(gradient[i] - sum(lower[i][k] * forward[k] for k in range(i)))
    step: list = [None] * size
    for i in reversed(range(size)):
        step[i] = forward[i] / pivots[i] - sum(lower[k][i] * step[k] for k in range(i + 1, size))
    return step, pivots[-1]
