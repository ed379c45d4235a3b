"""Frames to stripes: the pure function of a chunk, and the public call on whole stacks."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.fit import Window, fit_stripe, gather
from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, decode_table, frame_rank, laser_plane, laser_sites
from jaxscan.stripes.locate import Candidate, locate
from jaxscan.stripes.noise import estimate_noise
from jaxscan.stripes.select import accept
from jaxscan.stripes.stripes import NoiseModel, Stripes, StripeSettings


_CHUNK = 16
"""Frames per call of the compiled function."""
_SAMPLES = 24
"""Samples of a fit's window; wide stripes are binned by two so that it holds them."""


class FrameStripes(NamedTuple):
    """Fields of `Stripes` for the frames of a chunk, one laser; zero where not `valid`."""

    u: Float[Array, "frames lines"]
    sigma: Float[Array, "frames lines"]
    amplitude: Float[Array, "frames lines"]
    width: Float[Array, "frames lines"]
    chi2: Float[Array, "frames lines"]
    saturated: UInt8[Array, "frames lines"]
    valid: Bool[Array, "frames lines"]


def stripes_of_frames(
    on: UInt8[Array, "frames ..."],
    off: UInt8[Array, "frames ..."] | None,
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
) -> FrameStripes:
    """Stripe centres of a chunk of frames: pure, of static shapes, to be traced in a larger jit.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        noise_read: Read noise of one frame [DN].
        noise_gain: Conversion gain [e-/DN].
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb" (decoded before the fit).
        line: Which stripe to look for.
        settings: How stripes are found and believed.
    """
    sites = laser_sites(pixel_format, line)
    lines = on.shape[2] if line.stripe_axis == "columns" else on.shape[1]
    on = laser_plane(on, pixel_format=pixel_format, line=line)
    off = None if off is None else laser_plane(off, pixel_format=pixel_format, line=line)
    frames, plane_lines = on.shape[:2]
    candidate = locate(on, off, pitch=sites.pitch)
    window, middle, saturated, start = _window(
        on, off, candidate, sites.pitch, noise_read, noise_gain, response, settings
    )
    fit = fit_stripe(window, *start, iterations=settings.iterations, max_width=1.2 * settings.max_width_px)
    valid, sigma, chi2 = accept(
        fit,
        reach=0.5 * _SAMPLES * jnp.abs(window.x[1] - window.x[0]),
        parameters=3 if off is not None else 4,
        settings=settings,
    )
    u = middle + fit.u
    valid = valid & (u >= -0.5) & (u <= sites.pitch * on.shape[2] - 0.5)
    if len(sites.offsets) > 1 or sites.offsets[0]:
        offsets = jnp.asarray(sites.offsets, u.dtype)
        u = u + jnp.tile(offsets, frames * plane_lines // len(sites.offsets))

    def place(values: Array) -> Array:
        plane = jnp.where(valid, values, jnp.zeros_like(values)).reshape(frames, plane_lines)
        if plane_lines == lines:
            return plane
        image = jnp.zeros((frames, lines), plane.dtype)
        last = sites.first_line + sites.line_step * plane_lines
        return image.at[:, sites.first_line : last : sites.line_step].set(plane)

    return FrameStripes(
        u=place(u),
        sigma=place(sigma),
        amplitude=place(fit.amplitude),
        width=place(fit.width),
        chi2=place(chi2),
        saturated=place(saturated),
        valid=place(valid),
    )


def _window(
    on: UInt8[Array, "frames lines samples"],
    off: UInt8[Array, "frames lines samples"] | None,
    candidate: Candidate,
    pitch: int,
    noise_read: Float[Array, ""],
    noise_gain: Float[Array, ""],
    response: Response,
    settings: StripeSettings,
) -> tuple[Window, Float[Array, " rows"], UInt8[Array, " rows"], tuple]:
    """The samples around each candidate, and where the fit starts."""
    columns = on.shape[2]
    rows = on.shape[0] * on.shape[1]
    # Wide stripes do not need every pixel: two as one sample double the window's reach.
    bins = jnp.where(candidate.extent > _BIN_EXTENT_PX, 2, 1) if pitch == 1 else jnp.ones(rows, jnp.int32)
    bins = bins.astype(jnp.int32)
    spacing = bins * pitch
    first = jnp.round(candidate.u / pitch).astype(jnp.int32) - bins * (_SAMPLES // 2)
    sample = jnp.arange(_SAMPLES, dtype=jnp.int32)[:, None]
    index = first[None, :] + bins[None, :] * sample
    second = index + bins[None, :] - 1
    inside = (index >= 0) & (second < columns)
    row_start = columns * jnp.arange(rows, dtype=jnp.int32)[None, :]
    index, second = (jnp.clip(i, 0, columns - 1) + row_start for i in (index, second))
    middle = pitch * (first.astype(jnp.float32) + 0.5 * (bins - 1).astype(jnp.float32)) + 0.5 * (
        _SAMPLES - 1
    ) * spacing.astype(jnp.float32)
    x = spacing.astype(jnp.float32)[None, :] * (sample.astype(jnp.float32) - 0.5 * (_SAMPLES - 1))

    on_codes, on_codes_2 = gather(on, index), gather(on, second)
    level, rounding = _decode(on_codes, on_codes_2, response)
    variance = noise_read**2 + rounding
    clipped = jnp.maximum(on_codes, on_codes_2) >= settings.saturation
    if off is not None:
        off_codes, off_codes_2 = gather(off, index), gather(off, second)
        dark, rounding = _decode(off_codes, off_codes_2, response)
        variance = variance + noise_read**2 + rounding + 2.0 * dark / noise_gain
        clipped = clipped | (jnp.maximum(off_codes, off_codes_2) >= settings.saturation)
        level = level - dark
    u = candidate.u - middle
    near = jnp.abs(x - u[None, :]) <= 4.0 + 2.0 * candidate.extent[None, :]
    near = near & inside
    used = near & ~clipped
    count = (on_codes >= settings.saturation).astype(jnp.uint8)
    count = count + ((on_codes_2 >= settings.saturation) & (bins == 2)[None, :]).astype(jnp.uint8)
    saturated = jnp.sum(jnp.where(near, count, jnp.uint8(0)), 0, dtype=jnp.uint8)

    width = jnp.clip(candidate.extent / 2.355, 0.6, settings.max_width_px)
    background = None
    top = jnp.max(jnp.where(near, level, -1e3), 0)
    if off is None:
        bottom = jnp.min(jnp.where(near, level, 1e3), 0)
        background = bottom
        variance = variance + jnp.maximum(bottom, 0.0)[None, :] / noise_gain
        top = top - bottom
    amplitude = jnp.maximum(top, 1.0) * jnp.where(saturated > 0, 1.5, 1.0)
    per_bin = 1.0 / bins.astype(jnp.float32)
    window = Window(
        x=x,
        y=level,
        variance=variance * per_bin[None, :],
        used=used,
        aperture=bins.astype(jnp.float32),
        shot=per_bin / noise_gain,
    )
    return window, middle, saturated, (u, amplitude, width, background)


_BIN_EXTENT_PX = 11.0
"""Distance between half-maximum points from which samples are binned by two [px]."""


def _decode(
    codes: UInt8[Array, "samples rows"], codes_2: UInt8[Array, "samples rows"], response: Response
) -> tuple[Float[Array, "samples rows"], Float[Array, "samples rows"] | float]:
    """Mean linear level of two codes [DN], and the variance that rounding gives it [DN^2]."""
    if response == "linear":
        return 0.5 * (codes.astype(jnp.float32) + codes_2.astype(jnp.float32)), 1 / 12
    level, slope = decode_table(response)
    table = jnp.asarray(level, jnp.float32)
    rounding = jnp.asarray(slope**2 / 12, jnp.float32)
    return 0.5 * (table[codes] + table[codes_2]), 0.5 * (rounding[codes] + rounding[codes_2])


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
    line: LaserLine = LaserLine(),
    settings: StripeSettings = StripeSettings(),
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
        part = _compiled(
            *chunk, read, gain, pixel_format=pixel_format, response=response, line=line, settings=settings
        )
        parts.append(jax.tree.map(lambda a, n=len(on) - start: a[:n], part))
    joined = jax.tree.map(lambda *a: jnp.concatenate(a), *parts)
    count = len(on)
    return Stripes(
        **joined._asdict(), record=jnp.arange(count, dtype=jnp.int32), laser=jnp.zeros(count, jnp.int32)
    )


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
