"""Frames of a chunk to stripes: locate, fit, choose; all by XLA, or the search natively."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Int8, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.choosing.choose import choose
from jaxscan.stripes.fitting.fits import fit_candidates
from jaxscan.stripes.frames.flicker import applied_gain, pair_gain
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response, laser_plane, laser_sites
from jaxscan.stripes.search.candidates import CANDIDATES, Located
from jaxscan.stripes.search.locate import locate
from jaxscan.stripes.search.native import NativeLocator
from jaxscan.stripes.search.search import Search
from jaxscan.stripes.stripes import FrameStripes, StripeSettings


_LOOKS = (32, 80)
"""Lines and samples of a frame from which the brightness of a pair is compared."""


def stripes_of_frames(
    on: UInt8[Array, "frames ..."],
    off: UInt8[Array, "frames ..."] | None,
    search: Search,
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
        search: Where to look, and the noise.
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb" (decoded before the fit).
        line: Which stripe to look for.
        settings: How stripes are found and believed.

    Returns:
        A profile per frame; with `settings.choice` "all" one for each of its candidates.
    """
    size = on.shape[2], on.shape[1]
    located, gain = locate_frames(on, off, search, pixel_format=pixel_format, line=line, settings=settings)
    how: dict[str, Any] = {"pixel_format": pixel_format, "response": response, "line": line, "settings": settings}
    return stripes_of_located(located, gain, search, image_size=size, **how)


def locate_frames(
    on: UInt8[Array, "frames ..."],
    off: UInt8[Array, "frames ..."] | None,
    search: Search,
    *,
    pixel_format: PixelFormat,
    line: LaserLine,
    settings: StripeSettings,
) -> tuple[Located, Float[Array, " frames"]]:
    """The candidates of a chunk of frames and the gains of its pairs, by XLA; pure and traceable.

    Arguments as of `stripes_of_frames`; for `stripes_of_located`.
    """
    on = laser_plane(on, pixel_format=pixel_format, line=line)
    off = None if off is None else laser_plane(off, pixel_format=pixel_format, line=line)
    gain = frame_gains(sample_pair(on, off), search, frames=len(on))
    located = locate(
        on,
        off,
        pitch=laser_sites(pixel_format, line).pitch,
        low=search.low,
        high=search.high,
        gain=quantised(gain),
        thresholds=search.thresholds,
        levels=search.levels,
        saturation=settings.saturation,
    )
    return located, gain


def sample_pair(on: Array, off: Array | None) -> tuple[Array, Array] | None:
    """A lattice of pixels of every frame's plane, uint8 [frames, n], for `frame_gains`."""
    if off is None:
        return None
    steps = [max(1, size // looks) for size, looks in zip(on.shape[1:], _LOOKS, strict=True)]
    first, second = (frames[:, :: steps[0], :: steps[1]] for frames in (on, off))
    return first.reshape(len(on), -1), second.reshape(len(on), -1)


def frame_gains(pair: tuple[Array, Array] | None, search: Search, *, frames: int) -> Float[Array, " frames"]:
    """By what the light of every laser-off frame is to be multiplied: 1 unless the lamps flicker."""
    if pair is None:
        return jnp.ones(frames, jnp.float32)
    return applied_gain(pair_gain(*pair, search.read, search.gain)).astype(jnp.float32)


def quantised(gain: Float[Array, " frames"]) -> Int[Array, " frames"]:
    """Gains as `locate` takes them, in 1/128."""
    xp = np if isinstance(gain, np.ndarray) else jnp
    return xp.clip(xp.round(128.0 * gain), 0, 256).astype(np.int32)


def stripes_of_located(
    located: Located,
    gain: Float[Array, " frames"],
    search: Search,
    *,
    image_size: tuple[int, int],
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
) -> FrameStripes:
    """Fit the candidates of a chunk and choose among them; pure and traceable.

    Args:
        located: Candidates of all frames.
        gain: By what the light of each laser-off frame is multiplied.
        search: The noise, and which side is near.
        image_size: Width and height of a frame [px].
        pixel_format: How a frame is to be read.
        response: "linear" or "srgb".
        line: Which stripe was looked for.
        settings: How stripes are fitted, judged and chosen.
    """
    return candidates_of_located(
        located,
        gain,
        search,
        image_size=image_size,
        pixel_format=pixel_format,
        response=response,
        line=line,
        settings=settings,
        keep=settings.choice == "all",
    )[0]


def candidates_of_located(
    located: Located,
    gain: Float[Array, " frames"],
    search: Search,
    *,
    image_size: tuple[int, int],
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
    keep: bool,
) -> tuple[FrameStripes, Int8[Array, "frames lines"] | None]:
    """Fit the candidates of a chunk, choose among them, and keep the others; pure and traceable.

    Args:
        located, gain, search, image_size, pixel_format, response, line, settings: As of `stripes_of_located`.
        keep: Whether all candidates are given, or the chosen ones alone.

    Returns:
        stripes: A profile per frame; where all are kept one for each of its candidates.
        chosen: Number of each line's chosen candidate, -1 where there is none; None where
            nothing is chosen (`settings.choice` "all").
    """
    sites = laser_sites(pixel_format, line)
    lines, samples = _plane_shape(image_size, pixel_format, line)
    fits = fit_candidates(
        located.lists,
        gain,
        search.read,
        search.gain,
        (search.log_width, search.width_information),
        samples=samples,
        pitch=sites.pitch,
        response=response,
        settings=settings,
    )
    slots = jnp.asarray(located.slots)
    exists = slots >= 0
    index = jnp.where(exists, slots, 0)

    def take(field, index):
        return field.at[index].get(mode="promise_in_bounds")

    valid = exists & take(fits.valid, index)
    number = None
    if settings.choice != "all":
        u, snr, amplitude, width = (take(field, index) for field in (fits.u, fits.snr, fits.amplitude, fits.width))
        number = choose(u, snr, amplitude, width, valid, search.near_side, settings)
    if keep or number is None:
        chosen = jnp.where(valid, index, -1)
        chosen = jnp.moveaxis(chosen, 2, 1).reshape(-1, lines)
    else:
        chosen = jnp.full(number.shape, -1, index.dtype)
        for k in range(CANDIDATES):
            chosen = jnp.where(number == k, index[:, :, k], chosen)
    found = chosen >= 0
    index = jnp.where(found, chosen, 0)
    fields = {name: take(getattr(fits, name), index) for name in FrameStripes._fields if name != "valid"}
    offsets = jnp.asarray(sites.offsets, jnp.float32)[jnp.arange(lines) % len(sites.offsets)]
    fields["u"] = fields["u"] + offsets[None, :]
    stripes = FrameStripes(**{name: jnp.where(found, field, 0) for name, field in fields.items()}, valid=found)
    whole = image_size[1] if line.stripe_axis == "rows" else image_size[0]

    def on_image_lines(values, nothing=0):
        if whole == lines:
            return values
        image = jnp.full((len(values), whole), nothing, values.dtype)
        last = sites.first_line + sites.line_step * lines
        return image.at[:, sites.first_line : last : sites.line_step].set(values)

    return jax.tree.map(on_image_lines, stripes), None if number is None else on_image_lines(number, -1)


def _plane_shape(image_size: tuple[int, int], pixel_format: PixelFormat, line: LaserLine) -> tuple[int, int]:
    """Lines and samples of the laser's plane in frames of this width and height."""
    across, lines = image_size if line.stripe_axis == "rows" else image_size[::-1]
    sites = laser_sites(pixel_format, line)
    if sites.pitch == 1:
        return lines, across
    return lines // 2 * 2 // sites.line_step, across // 2


_gains = jax.jit(frame_gains, static_argnames="frames")
_locator = NativeLocator()


def is_native(off: Array | None) -> bool:
    """Whether `locate_natively` serves these frames on this machine."""
    return off is not None and jax.default_backend() == "cpu"


def locate_natively(
    on: Array, off: Array, search: Search, *, pixel_format: PixelFormat, line: LaserLine, settings: StripeSettings
) -> tuple[Located, Array]:
    """The candidates of a chunk of frames, by the native search, and the gains of its pairs.

    Arguments as of `stripes_of_frames`. What is returned is good until the next call in the same
    thread; pass it on to `stripes_of_located`.
    """
    on, off = (_plane(frames, pixel_format, line) for frames in (on, off))
    gain = np.asarray(_gains(sample_pair(on, off), search, frames=len(on)))
    located = _locator.locate(
        on,
        off,
        pitch=laser_sites(pixel_format, line).pitch,
        low=np.asarray(search.low),
        high=np.asarray(search.high),
        gain=np.asarray(quantised(gain)),
        thresholds=np.asarray(search.thresholds),
        levels=np.asarray(search.levels),
        saturation=settings.saturation,
    )
    return located, gain


def _plane(frames: Array, pixel_format: PixelFormat, line: LaserLine) -> np.ndarray:
    plane = np.asarray(laser_plane(np.asarray(frames), pixel_format=pixel_format, line=line))
    # Samples that lie a line apart would each cost a cache line of their own.
    return np.ascontiguousarray(plane) if line.stripe_axis == "columns" else plane
