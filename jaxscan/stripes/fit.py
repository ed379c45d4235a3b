r"""Maximum-likelihood fit of a pixel-integrated Gaussian to the samples around every candidate, and which are believed.

A Gaussian of width w that is averaged over a pixel of length a has the variance $w^2 + a^2 / 12$, no skewness, and the
fourth cumulant $-a^4 / 120$. The fit therefore knows a Gaussian of the widened variance with a small correction, and
gives back w; the neglected terms are of sixth order in a / w.

All derivatives of a Gaussian are the Gaussian times powers of x. Every sum that the normal equations need is thus one
of a few moments over the samples, and as the samples lie on the same lattice in every window, all moments together are
a product with a constant matrix. The arrays have the samples first and the candidates last: every other operation is
one long vector.
"""

import math
import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Array
from jaxscan.memory import folded, in_blocks
from jaxscan.stripes.peaks import WINDOW, Peaks
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import FrameStripes


UNUSED_VARIANCE = 1e15
"""Variance of a sample that does not count [DN^2]; not larger, so that no product with its weight is denormal."""
MIN_WIDTH_PX = 0.3
"""Below this the width of a stripe cannot be told from its pixel's [px]."""
REST = 0.05
"""Error in standard deviations with which a fit may end early; it adds 0.25 % to the variance."""
FILTER_VARIANCE = {1: 3.1, 2: 2.8}
"""Addition of the fine filter, its lattice and the pixel to the square of the width between half-maximum points, by
pitch, for widths of 0.7 to 3 px [px^2]."""
CERTAIN = 5.0
"""Standard deviations by which the shift of an edge must stand out of the noise of the laser-off frame."""
FLOOR = 2.0
"""Standard deviations of the noise below which a level of the laser-off frame is not believed."""
_SMALL_STEP = 0.3
"""Relative change of amplitude and width up to which a step is taken as it is [1]."""
_SMALLEST = 0.25
"""Smallest squared width of a fit, the pixel's own 1/12 and a little for the stripe [samples^2]."""
_FAR = 40.0
"""Squared distance from the centre, in widths, from which on a Gaussian is nothing: processors take a hundred times as
long for the denormal numbers that it and its square would be."""
_PIXEL = 1.0 / 12.0
"""Addition of a pixel's aperture to the square of a stripe's width [px^2]."""


class Window(NamedTuple):
    """Samples around a candidate."""

    y: Float[Array, "samples stripes"]
    """Level: on minus off, or on where there is no off [DN]."""
    variance: Float[Array, "samples stripes"]
    """Variance of `y` without the stripe's own shot noise [DN^2]; UNUSED_VARIANCE where the sample does not count."""
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

    max_width: Float[Array, ""] | float
    """Largest width that a step may reach [px]."""
    prior: tuple[Float[Array, ""], Float[Array, ""]] | None = None
    """Mean of the logarithm of the widened width [px], and its information; None where nothing is known."""
    speckle: Float[Array, "#stripes"] | float = 0.0
    """Contrast of the laser's speckle within a sample [1]."""
    rest: float = 0.0
    """Error of the centre, in its standard deviations, with which the steps may end early: after a step about its size
    times the relative change of the parameters is left."""


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


def fit_peaks(
    on: Plane,
    off: Plane | None,
    lamp_ratio: Float[Array, ""],
    peaks: Peaks,
    search: Search,
    *,
    pitch: int,
    linear: bool,
) -> FrameStripes:
    """Fit and judge the candidates of one frame, those that exist packed one after the other.

    Args:
        search: The noise, the prior of the width, and the limits of what is believed.
    """
    lines = on.samples.shape[0]
    flat = [jnp.asarray(field).reshape(-1) for field in (peaks.at, peaks.extent, peaks.first, peaks.bins)]

    def block(some: Array, real: Array) -> FrameStripes:
        at, extent, first, bins = (field.at[some].get(mode="promise_in_bounds") for field in flat)
        cut = _Cut(some % lines, at, extent, first, bins, real)
        return _fit_block(on, off, lamp_ratio, cut, search, pitch, linear)

    found = in_blocks(peaks.exists.reshape(-1), block)
    return jax.tree.map(lambda field: field.reshape(peaks.exists.shape), found)


class _Cut(NamedTuple):
    """Candidates of a block: line, centre [px], extent [px], first sample, samples per bin, whether it is one."""

    line: Array
    at: Array
    extent: Array
    first: Array
    bins: Array
    real: Array


def _fit_block(
    on: Plane, off: Plane | None, ratio: Array, cut: _Cut, search: Search, pitch: int, linear: bool
) -> FrameStripes:
    """Fit and judge some candidates."""
    samples, limits = on.samples.shape[1], search.limits
    place = jnp.asarray(sample_places(WINDOW))[:, None]
    bins = cut.bins.astype(jnp.float32)
    step, per_bin, per_dn = pitch * bins, 1.0 / bins, search.electrons_per_dn
    middle = pitch * (cut.first.astype(jnp.float32) + 0.5 * (WINDOW * bins - 1.0))
    start = cut.at - middle
    x = place * step[None] - start[None]
    inside, code_on, code_off = _codes(on, off, cut)
    near = inside & (jnp.abs(x) <= cut.extent[None] + 1.0)
    top_code = limits.saturation.astype(jnp.uint8)
    clipped = [code >= top_code for code in code_on]
    both = clipped[0].astype(jnp.float32) + (clipped[1] & (cut.bins == 2)[None]).astype(jnp.float32)
    saturated = folded(operator.add, jnp.where(near, both, 0.0))
    used = near & ~clipped[0] & ~clipped[1]
    level, rounding = _levels(code_on, search, linear)
    frame = search.read_dn**2
    variance: Array | float = frame + rounding
    dark = None
    if code_off is not None:
        used &= (code_off[0] < top_code) & (code_off[1] < top_code)
        dark, dark_rounding = _levels(code_off, search, linear)
        dark = jnp.where(inside, dark, 0.0)
        level = level - ratio * dark
        light = jnp.maximum(dark - search.black_dn, 0.0) / per_dn
        variance = variance + ratio * light + ratio * ratio * (frame + dark_rounding + light)
    top = folded(jnp.maximum, jnp.where(used, level, -1e3))
    background = None
    if dark is None:
        background = jnp.clip(folded(jnp.minimum, jnp.where(used, level, 1e3)), 0.0, 1e3)
        variance = variance + jnp.maximum(background - search.black_dn, 0.0)[None] / per_dn
        top = top - background
    # The half-widths at half of the maximum and at the clipped top give width and amplitude of a Gaussian that is cut
    # off. Where it is not, the filter widened it.
    flat = 0.5 * pitch * saturated
    spread = jnp.where(saturated > 0, 1.0, FILTER_VARIANCE[pitch])
    squared = (0.25 * cut.extent**2 - flat**2) / (2.0 * math.log(2.0)) - spread
    width = jnp.clip(jnp.sqrt(jnp.maximum(squared, 0.36)), 0.6, limits.max_width_px)
    amplitude = jnp.maximum(top, 1.0) * jnp.exp(jnp.minimum(0.5 * (flat / width) ** 2, 1.5))
    window = Window(level, jnp.where(used, variance * per_bin[None], UNUSED_VARIANCE), step, bins, per_bin / per_dn)
    prior = search.log_width, search.width_information
    rules = FitRules(1.1 * limits.max_width_px, prior, search.speckle * lax.rsqrt(bins), REST)
    steps = jnp.where(saturated > 0, limits.clipped_iterations, limits.iterations)
    fit = fit_stripe(window, Start(start, amplitude, width, background), rules, iterations=steps, active=cut.real)
    tallest = jnp.where(saturated > 0, jnp.inf, 2.0 * amplitude)
    valid, sigma, chi2 = _accept(fit, 0.5 * WINDOW * step, tallest, 3 if background is None else 4, search)
    u = middle + fit.u
    valid &= cut.real & (u >= -0.5) & (u <= pitch * (samples - 1) + 0.5)
    grey: Array = jnp.zeros_like(u)
    if dark is not None:
        grey = folded(operator.add, jnp.maximum(1.0 - jnp.abs(place - (fit.u / step)[None]), 0.0) * dark)
        # An edge of the surface's reflectance under the stripe may have moved the centre.
        room = (frame + 1 / 12 + jnp.maximum(dark - search.black_dn, 0.0) / per_dn) / step[None]
        shift, _ = albedo_shift(dark, place * step[None], used, room, fit.u, fit.width, offset=search.black_dn)
        sigma = jnp.sqrt(sigma * sigma + limits.guard_edges * shift * shift)
    snr = jnp.sqrt(jnp.maximum(fit.energy, 0.0))
    clips = jnp.minimum(saturated, 255.0).astype(jnp.uint8)
    found = FrameStripes(u, sigma, fit.amplitude, fit.width, chi2, fit.skew, snr, grey, clips, valid)
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field)), found)


def _codes(on: Plane, off: Plane | None, cut: _Cut) -> tuple[Array, tuple[Array, Array], tuple[Array, Array] | None]:
    """Whether each sample of the windows is in the image, and the first and last code of its bin."""
    samples = on.samples.shape[1]
    index = cut.first[None] + cut.bins[None] * np.arange(WINDOW, dtype=np.int32)[:, None]
    last = index + cut.bins[None] - 1
    inside = (index >= 0) & (last < samples)
    frames = (on,) if off is None else (on, off)

    def taken(index: Array) -> tuple[Array, ...]:
        return tuple(frame.at(cut.line[None], jnp.clip(index, 0, samples - 1)) for frame in frames)

    # Branches, because what comes out of them is kept: else XLA reads the image again for each use of a code.
    nothing = tuple(jnp.zeros(index.shape, jnp.uint8) for _ in frames)
    first = lax.cond(jnp.any(cut.real), taken, lambda _: nothing, index)
    second = lax.cond(jnp.any(cut.bins == 2), taken, lambda _: first, last)
    codes = list(zip(first, second, strict=True))
    return inside, codes[0], None if off is None else codes[1]


def _levels(codes: tuple[Array, Array], search: Search, linear: bool) -> tuple[Array, Array | float]:
    """Linear level of a bin [DN], and the variance that rounding gives to a sample of it [DN^2]."""
    if linear:
        return 0.5 * (codes[0].astype(jnp.float32) + codes[1].astype(jnp.float32)), 1 / 12
    first, last = ((jnp.asarray(search.levels)[code], jnp.asarray(search.rounding)[code]) for code in codes)
    return 0.5 * (first[0] + last[0]), 0.5 * (first[1] + last[1])


def _accept(fit: Fit, reach: Array, tallest: Array, parameters: int, search: Search) -> tuple[Array, Array, Array]:
    """Which fits are believed, the sigmas of their centres [px], chi-squared per degree of freedom.

    A stripe is believed if it stands out of the noise, its width is possible, its fit came to rest inside the window,
    and its residuals are noise or a small part of the stripe itself (real profiles are not Gaussian). One side of an
    edge is no top of a hill that lies mostly below the ground: such a fit is taller than its samples.
    """
    limits = search.limits
    freedom = jnp.maximum(fit.samples - parameters, 1.0)
    chi2 = fit.chi2 / freedom
    expected = 1.0 + 3.0 * jnp.sqrt(2.0 / freedom)
    sigma = jnp.sqrt(fit.variance * jnp.maximum(chi2 / expected, 1.0))
    valid = (
        (fit.samples > parameters)
        & (fit.energy >= limits.least_snr**2)
        & (fit.variance > 0)
        & (sigma <= limits.max_sigma_px)
        & (fit.width >= limits.min_width_px)
        & (fit.width <= limits.max_width_px)
        & (fit.amplitude <= tallest)
        & (fit.last_step <= 0.02 + sigma)
        & (jnp.abs(fit.u) <= reach)
        & (fit.chi2 <= limits.max_chi2 * freedom + limits.max_misfit**2 * fit.energy)
    )
    return valid, sigma, chi2


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
    $1 / (\mathrm{variance} + \mathrm{shot} \cdot \max(F, 0) + (\mathrm{speckle} \cdot F)^2)$ from the present model F,
    which converges to the maximum of the likelihood; the normal matrix is then its information.

    Args:
        start: Where to start; with a background where that is to be fitted too.
        rules: The prior of the width, and when the steps end.
        iterations: Largest number of steps, of all or of each.
        active: Which candidates are real; all where not given.

    Source:
        S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 7.7 (scoring);
        equation 3.31 (information of a signal in Gaussian noise).
    """
    dtype = window.y.dtype
    place = jnp.asarray(sample_places(window.y.shape[0]), dtype)[:, None]
    powers = jnp.concatenate([place.T**k for k in range(7)])
    free = start.background is not None
    base = jnp.zeros_like(start.u) if start.background is None else start.background
    pixel = (window.aperture / window.step) ** 2 / 12
    speckle = jnp.atleast_1d(jnp.asarray(rules.speckle, dtype))
    most = (rules.max_width / window.step) ** 2 + pixel
    log_step = jnp.log(window.step)

    def modelled(*parameters):
        """Gaussian, residual, weight, and variance without speckle."""
        u, amplitude, squared, base = (parameter[None] for parameter in parameters)
        s = jnp.minimum((place - u) ** 2 * (1.0 / squared), _FAR)
        gauss = jnp.exp(-0.5 * s)
        # The fourth cumulant of the pixel, by the Hermite polynomial that belongs to it.
        flatness = -0.05 * (pixel * pixel)[None] / (squared * squared)
        model = amplitude * gauss * (1.0 + flatness * ((s - 6.0) * s + 3.0))
        bright = jnp.maximum(model, 0.0)
        spread = window.variance + window.shot[None] * bright
        grain = speckle[None] * bright
        return gauss, window.y - model - base, 1.0 / (spread + grain * grain), spread

    def solved(u, amplitude, squared, base, degree):
        """Step, information of the centre, what the step explains, and the moments of weight and residual."""
        gauss, residual, weight, _ = modelled(u, amplitude, squared, base)
        weighted = weight * gauss
        about = _about(powers[: degree + 3] @ (weighted * gauss), u, squared)
        first = _about(powers[:degree] @ (weighted * residual), u, squared)
        # Parameters: amplitude, width and centre, the last two relative to the width. The centre last: its pivot is
        # then the information that is left to it.
        normal = [[about[0]], [about[2], about[4]], [about[1], about[3], about[2]]]
        gradient = [first[0], first[2], first[1]]
        if rules.prior is not None:
            # The parameters are per amplitude.
            per_amplitude = rules.prior[1] / amplitude
            missing = rules.prior[0] - 0.5 * jnp.log(squared) - log_step
            normal[1] = [normal[1][0], normal[1][1] + per_amplitude / amplitude]
            gradient[1] = gradient[1] + per_amplitude * missing
        if free:
            plain = _about(powers[:3] @ weighted, u, squared)
            normal = [[powers[0] @ weight], [plain[0], *normal[0]], [plain[2], *normal[1]], [plain[1], *normal[2]]]
            gradient.insert(0, powers[0] @ (weight * residual))
        delta, pivot = _solve(normal, gradient)
        explained = sum(d * g for d, g in zip(delta, gradient, strict=True))
        return delta, pivot, explained, (about, first)

    def step(state):
        number, moving, u, amplitude, squared, base, *_ = state
        delta, pivot, _, _ = solved(u, amplitude, squared, base, 3)
        width = jnp.sqrt(squared)
        by_u, by_w = delta[-1] / amplitude, delta[-2] / amplitude
        # Large steps in log amplitude and 1 / width^2, in which the logarithm of a Gaussian is linear: where the top is
        # clipped, steps in amplitude and width would overshoot again and again.
        by_a = jnp.clip(delta[-3] / amplitude, -1.2, 1.2)
        small = jnp.abs(by_a) + jnp.abs(by_w) < _SMALL_STEP
        taller = amplitude * jnp.where(small, 1.0 + by_a, jnp.exp(by_a))
        left = by_u * (jnp.abs(by_u) + jnp.abs(by_w) + jnp.abs(delta[-3]) / amplitude)
        goes_on = (number + 1 < iterations) & ((number < 1) | (left * left * taller * taller * pivot > rules.rest**2))
        limit = jnp.maximum(1.0, 1.0 / width)
        wider = squared * jnp.where(small, (1.0 + by_w) ** 2, 1.0 / (1.0 - 2.0 * jnp.clip(by_w, -0.8, 0.3)))
        after = (
            moving & goes_on,
            u + width * jnp.clip(by_u, -limit, limit),
            taller,
            jnp.clip(wider, _SMALLEST, most),
            base + delta[0] if free else base,
            width * by_u,
            taller * taller * pivot / squared,
        )
        # A candidate at rest stays as it is, so that none depends on its neighbours.
        return number + 1, *jax.tree.map(lambda new, old: jnp.where(moving, new, old), after, state[1:])

    moving = jnp.ones(start.u.shape, jnp.bool_) if active is None else active
    squared = jnp.clip((start.width / window.step) ** 2 + pixel, _SMALLEST, most)
    # Integration over a pixel keeps the area.
    lower = start.amplitude * start.width / window.step / jnp.sqrt(squared)
    first = (jnp.int32(0), moving, start.u / window.step, lower, squared, base, *(jnp.zeros_like(start.u),) * 2)
    # GPUs may multiply float32 matrices with 10 bits otherwise.
    with jax.default_matmul_precision("highest"):
        # The information is that of the last step: about the fitted width, which noise makes too narrow as often as too
        # wide, the sigmas of faint stripes would be too small.
        _, _, u, amplitude, squared, base, last, information = lax.while_loop(
            lambda state: jnp.any(state[1]), step, first
        )
        _, _, explained, (about, moments_of) = solved(u, amplitude, squared, base, 4)
        gauss, residual, weight, spread = modelled(u, amplitude, squared, base)
        # Where steps are not at their end, what the next would explain is no misfit.
        chi2 = jnp.maximum(powers[0] @ (weight * residual * residual) - explained, 0.0)
        # Where there is no stripe there is no speckle either.
        energy = amplitude * amplitude * (powers[0] @ (gauss * gauss / spread))
    # The third Hermite polynomial without the part that a shift of the centre explains.
    shifted = (about[4] - 3.0 * about[2]) ** 2 / jnp.maximum(about[2], 1e-12)
    cubic = about[6] - 6.0 * about[4] + 9.0 * about[2] - shifted
    skew = 6.0 * (moments_of[3] - 3.0 * moments_of[1]) / jnp.maximum(amplitude * cubic, 1e-12)
    determined = information > 0
    width = jnp.sqrt(jnp.maximum(squared - pixel, (MIN_WIDTH_PX / window.step) ** 2))
    return Fit(
        u=u * window.step,
        amplitude=amplitude * jnp.sqrt(squared) / width,
        width=width * window.step,
        variance=jnp.where(determined, window.step**2 / jnp.where(determined, information, 1.0), 0.0),
        chi2=chi2,
        skew=skew,
        energy=energy,
        samples=folded(operator.add, (window.variance < UNUSED_VARIANCE).astype(dtype)),
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


def albedo_shift(
    level: Float[Array, "samples n"],
    x: Float[Array, "samples n"],
    used: Bool[Array, "samples n"],
    variance: Float[Array, "#samples #n"],
    u: Float[Array, " n"],
    width: Float[Array, " n"],
    *,
    offset: Float[Array, ""] | float = 0.0,
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    r"""Displacement of fitted centres by the reflectance of the surface around them.

    Under even ambient light the laser-off frame shows the reflectance $\rho$. The visible stripe is $\rho$ times the
    laser's light, so with the fitted Gaussian $h$ that light is $h / \rho$, and its centre is the true one:

    $$\mathrm{shift} = \frac{\sum x\,h}{\sum h} - \frac{\sum x\,h / \rho}{\sum h / \rho} \approx w^2 \rho' / \rho .$$

    On a straight slope this is the displacement that a straight line through the laser-off frame gives; at printed
    edges of 5 : 1, where the line gives half of it, it stays within a quarter. A shift below `CERTAIN` standard
    deviations of the noise is 0, so that a clean surface keeps its sigma.

    Args:
        level: The laser-off frame in the window of the fit [DN].
        x: Coordinates of the samples, evenly spaced and rising [px].
        used: Samples that the fit used.
        variance: Of `level` [DN^2].
        u: Fitted centre, in the coordinates of `x` [px].
        width: Fitted standard deviation of the stripe [px].
        offset: Level of a pixel without light [DN].

    Returns:
        Fitted centre minus the centre of the laser's light, 0 where it is lost in the noise, and its standard
        deviation by that noise [px]. For an honest standard deviation of the centre add the square of the shift to its
        square.
    """
    seen = jnp.sqrt(width * width + _PIXEL)
    z = (x - u[None, :]) * (1.0 / seen)[None, :]
    light = jnp.where(used, jnp.exp(-0.5 * jnp.minimum(z * z, _FAR)), 0.0)
    variance = jnp.broadcast_to(jnp.asarray(variance), z.shape)
    level = jnp.maximum(level - offset, FLOOR * jnp.sqrt(variance))
    per_level = 1.0 / level
    source = light * per_level
    # Derivative of the centre by one sample's level: (z - mean) source / level / sum(source).
    pull = source * per_level
    pull = pull * pull * variance
    # Sums over the window, times 1, s and s^2 with s the sample's number from the middle: products with a fixed matrix,
    # of which a CPU's compiler makes several times more than of as many sums.
    number = sample_places(z.shape[0]).astype(np.float64)
    powers = np.stack([number**power for power in range(3)]).astype(z.dtype)
    summed = lambda values, count: jnp.matmul(powers[:count], values, precision=lax.Precision.HIGHEST)
    (total, first), (plain, plain_first) = summed(source, 2), summed(light, 2)
    pulls, pulls_s, pulls_ss = summed(pull, 3)
    some = total > 0
    total = jnp.where(some, total, 1.0)
    mean = first / total
    square = jnp.maximum(pulls_ss - 2.0 * mean * pulls_s + mean * mean * pulls, 0.0)
    pitch = x[1] - x[0]
    sigma = pitch * jnp.sqrt(square) / total
    shift = pitch * (plain_first / jnp.where(some, plain, 1.0) - mean)
    certain = some & (jnp.abs(shift) > CERTAIN * sigma)
    return jnp.where(certain, shift, 0.0), sigma
