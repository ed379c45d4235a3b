"""Frames to stripes: the pure function of a chunk, and the public call on whole stacks."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.fit import fit_stripe
from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, frame_rank, laser_plane, laser_sites
from jaxscan.stripes.locate import locate
from jaxscan.stripes.noise import estimate_noise
from jaxscan.stripes.select import accept
from jaxscan.stripes.shifted import Shifted
from jaxscan.stripes.stripes import NoiseModel, Stripes, StripeSettings
from jaxscan.stripes.window import (
    FEW_SAMPLES,
    SAMPLES,
    Placement,
    cut_window,
    is_near,
    place_window,
    window_middle,
)


_LINE, _SETTINGS = LaserLine(), StripeSettings()
_CHUNK = 16
"""Frames per call of the compiled function."""
_REST = 0.02
"""Error in standard deviations with which a fit may end early; it adds 0.04 % to the variance."""


class FrameStripes(NamedTuple):
    """Fields of `Stripes` for the frames of a chunk, one laser; zero where not `valid`."""

    u: Float[Array, "*frames lines"]
    sigma: Float[Array, "*frames lines"]
    amplitude: Float[Array, "*frames lines"]
    width: Float[Array, "*frames lines"]
    chi2: Float[Array, "*frames lines"]
    saturated: UInt8[Array, "*frames lines"]
    valid: Bool[Array, "*frames lines"]


def stripes_of_frames(
    on: UInt8[Array, "frames ..."] | Shifted,
    off: UInt8[Array, "frames ..."] | Shifted | None,
    noise_read: Float[Array, ""] | float,
    noise_gain: Float[Array, ""] | float,
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
) -> FrameStripes:
    """Stripe centres of a chunk of frames: pure, of static shapes, to be traced in a larger jit.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3); `Shifted` ones only on
            a CPU, and where `takes_shifted` says so.
        off: Laser-off frames of the same shape, or None.
        noise_read: Read noise of one frame [DN].
        noise_gain: Conversion gain [e-/DN].
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb" (decoded before the fit).
        line: Which stripe to look for.
        settings: How stripes are found and believed.
    """
    read, gain = jnp.asarray(noise_read, jnp.float32), jnp.asarray(noise_gain, jnp.float32)
    sites = laser_sites(pixel_format, line)
    lines = on.shape[2] if line.stripe_axis == "columns" else on.shape[1]
    on = on if isinstance(on, Shifted) else laser_plane(on, pixel_format=pixel_format, line=line)
    if off is not None and not isinstance(off, Shifted):
        off = laser_plane(off, pixel_format=pixel_format, line=line)

    # Loops over frames stay within a CPU's caches, which is several times faster there; and what
    # passes from one loop to the next is computed once, not again for every use.
    def find(planes):
        return locate(*planes, pitch=sites.pitch)

    def find_one_by_one(planes):
        return lax.map(lambda number: find(_pick(planes, number)), jnp.arange(len(planes[0])))

    candidate = _each_frame(find, (on, off), find_one_by_one)
    placement = place_window(candidate, sites.pitch)

    def fit(planes_and_placement, samples=SAMPLES, binned=True):
        (on, off), placement = planes_and_placement
        how = {"samples": samples, "binned": binned}
        return _fit_frame(on, off, placement, read, gain, sites.pitch, response, settings, **how)

    def fit_one_by_one(planes_and_placement):
        planes, placement = planes_and_placement

        def least(number_and_placement):
            # Only what the frame's widest stripe needs. The frame is picked inside of the branch,
            # or it would be copied.
            number, placement = number_and_placement
            edge = 0.5 * sites.pitch * (FEW_SAMPLES + 1)
            long = jnp.any(is_near(jnp.array([[-edge], [edge]], jnp.float32), placement))
            kind = jnp.where(jnp.any(placement.bins > 1), 2, jnp.where(long, 1, 0))
            branches = [
                lambda number, placement, kind=kind: fit((_pick(planes, number), placement), *kind)
                for kind in ((FEW_SAMPLES, False), (SAMPLES, False), (SAMPLES, True))
            ]
            return lax.switch(kind, branches, number, placement)

        return lax.map(least, (jnp.arange(len(planes[0])), placement))

    stripes = _each_frame(fit, ((on, off), placement), fit_one_by_one)
    offsets = jnp.asarray(sites.offsets, jnp.float32)[jnp.arange(on.shape[1]) % len(sites.offsets)]
    stripes = stripes._replace(u=jnp.where(stripes.valid, stripes.u + offsets[None, :], 0.0))

    def place(values: Array) -> Array:
        if values.shape[1] == lines:
            return values
        image = jnp.zeros((len(values), lines), values.dtype)
        last = sites.first_line + sites.line_step * values.shape[1]
        return image.at[:, sites.first_line : last : sites.line_step].set(values)

    return jax.tree.map(place, stripes)


def takes_shifted(pixel_format: PixelFormat, line: LaserLine) -> bool:
    """Whether frames are their own laser plane, so that they need no rearranging in memory."""
    return pixel_format == "mono8" and line.stripe_axis == "rows"


def _is_shifted(frames: Any) -> bool:
    return isinstance(frames, Shifted)


def _pick(planes: Any, number: Array) -> Any:
    """One of the frames of every stack."""
    return jax.tree.map(lambda a: a[number].array() if _is_shifted(a) else a[number], planes, is_leaf=_is_shifted)


def _each_frame(function: Callable, arrays: Any, one_by_one: Callable) -> Any:
    """A function of one frame over all frames: in a loop on a CPU, at once elsewhere.

    Args:
        function: Takes the arrays of one frame.
        arrays: Arrays with a leading axis over frames.
        one_by_one: The loop; takes the arrays of all frames.
    """
    if any(_is_shifted(leaf) for leaf in jax.tree.leaves(arrays, is_leaf=_is_shifted)):
        return one_by_one(arrays)
    return lax.platform_dependent(arrays, cpu=one_by_one, default=lambda a: jax.vmap(function)(a))


def _fit_frame(
    on: UInt8[Array, "lines samples"],
    off: UInt8[Array, "lines samples"] | None,
    placement: Placement,
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    pitch: int,
    response: Response,
    settings: StripeSettings,
    *,
    samples: int,
    binned: bool,
) -> FrameStripes:
    """Stripe centres of one frame's plane, from each line's first sample [px]."""
    cut = functools.partial(cut_window, samples=samples, binned=binned)
    window, saturated, first = cut(on, off, placement, pitch, noise_read, noise_gain, response, settings)
    fit = fit_stripe(
        window,
        first,
        iterations=settings.iterations,
        max_width=1.1 * settings.max_width_px,
        min_snr=settings.min_snr,
        rest=_REST,
    )
    valid, sigma, chi2 = accept(
        fit,
        reach=0.5 * SAMPLES * pitch * window.aperture,
        tallest=jnp.where(saturated > 0, jnp.inf, 2.0 * first.amplitude),
        parameters=3 if off is not None else 4,
        settings=settings,
    )
    u = window_middle(placement.first, placement.bins, pitch) + fit.u
    valid = valid & (u >= -0.5) & (u <= pitch * (on.shape[1] - 1) + 0.5)
    found = FrameStripes(u, sigma, fit.amplitude, fit.width, chi2, saturated.astype(jnp.uint8), valid)
    return jax.tree.map(lambda field: jnp.where(valid, field, jnp.zeros_like(field)), found)


@functools.partial(jax.jit, static_argnames=("line", "pixel_format", "response", "settings"))
def _compiled(on, off, noise_read, noise_gain, *, pixel_format, response, line, settings):
    return stripes_of_frames(
        on,
        off,
        noise_read,
        noise_gain,
        pixel_format=pixel_format,
        response=response,
        line=line,
        settings=settings,
    )


def extract_stripes(
    on: Array,
    off: Array | None = None,
    *,
    pixel_format: PixelFormat = "mono8",
    response: Response = "linear",
    line: LaserLine = _LINE,
    settings: StripeSettings = _SETTINGS,
    noise: NoiseModel | None = None,
) -> Stripes:
    """Sub-pixel centre of the laser's stripe on every line of every frame.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3), NumPy or JAX.
        off: Laser-off frames of the same shape; None where there are none.
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb" (decoded before the fit; levels then are linear DN).
        line: Which stripe to look for.
        settings: How stripes are found and believed.
        noise: Noise of a frame; estimated from the frames where not given.

    Returns:
        Stripes, one profile per frame (`record` counts frames, `laser` is 0), float32.

    Raises:
        ValueError: If shapes or types do not fit the pixel format.
    """
    _check(on, off, pixel_format)
    if noise is None:
        noise = estimate_noise(on, off, pixel_format=pixel_format, response=response, line=line)
    read, gain = jnp.float32(noise.read_dn), jnp.float32(noise.electrons_per_dn)
    parts = []
    for start in range(0, len(on), _CHUNK):
        chunk = [None if a is None else _padded(a[start : start + _CHUNK], len(on)) for a in (on, off)]
        part = _compiled(*chunk, read, gain, pixel_format=pixel_format, response=response, line=line, settings=settings)
        parts.append(part)
    count = len(on)
    joined = jax.tree.map(lambda *a: jnp.concatenate(a)[:count], *parts)
    return Stripes(**joined._asdict(), record=jnp.arange(count, dtype=jnp.int32), laser=jnp.zeros(count, jnp.int32))


def _padded(frames: Array, total: int) -> Array:
    """A short last chunk filled up, so that one compiled function serves all."""
    missing = min(_CHUNK, total) - len(frames)
    if missing == 0:
        return frames
    xp = np if isinstance(frames, np.ndarray) else jnp
    return xp.concatenate([frames, xp.zeros((missing, *frames.shape[1:]), frames.dtype)])


def _check(on: Array, off: Array | None, pixel_format: PixelFormat) -> None:
    rank = 1 + frame_rank(pixel_format)
    if on.ndim != rank or on.dtype != np.uint8 or len(on) == 0:
        raise ValueError(
            f"`on` must be uint8 with {rank} dimensions for {pixel_format} and hold at least one frame, "
            f"got {on.dtype} with shape {tuple(on.shape)}."
        )
    if off is not None and (off.shape != on.shape or off.dtype != np.uint8):
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {tuple(off.shape)}.")
