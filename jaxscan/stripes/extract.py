"""Frames to stripes: the functions of a chunk, and the public call on whole stacks."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Int8, Int16, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.candidates import CANDIDATES, Located, thresholds
from jaxscan.stripes.choose import choose
from jaxscan.stripes.fits import fit_candidates
from jaxscan.stripes.flicker import applied_gain, pair_gain
from jaxscan.stripes.frames import (
    LaserLine,
    PixelFormat,
    Response,
    decode_table,
    frame_rank,
    laser_plane,
    laser_sites,
)
from jaxscan.stripes.learn_colour import with_colour
from jaxscan.stripes.locate import locate
from jaxscan.stripes.native import NativeLocator
from jaxscan.stripes.noise import estimate_noise
from jaxscan.stripes.stripes import NoiseModel, Stripes, StripeSettings
from jaxscan.stripes.widths import LEARNED_FRAMES, learn_widths


_LINE, _SETTINGS = LaserLine(), StripeSettings()
_CHUNK = 16
"""Frames per call of the compiled function."""
_LOOKS = (32, 80)
"""Lines and samples of a frame from which the brightness of a pair is compared."""


class Search(NamedTuple):
    """Where and from which signal on candidates are looked for; arrays, so a change compiles nothing."""

    low: Int[Array, " lines"]
    """First sample of each line of the laser's plane that may hold the stripe."""
    high: Int[Array, " lines"]
    """The sample behind the last one."""
    thresholds: Int16[Array, "256"]
    """Smallest response of a candidate, by the mean level of its line."""
    levels: Float[Array, "256"]
    """Linear level of each code [DN]."""
    read: Float[Array, ""]
    """Read noise of one frame [DN]."""
    gain: Float[Array, ""]
    """Conversion gain [e-/DN]."""
    log_width: Float[Array, ""]
    """Mean of the logarithm of what the fit sees of a stripe's width [px]."""
    width_information: Float[Array, ""]
    """Information of this mean as a prior of each stripe [1]; 0 while nothing is known."""
    near_side: Float[Array, ""]
    """+1 where what is nearer has the larger centre, else -1; 0 if unknown."""


class FrameStripes(NamedTuple):
    """Fields of `Stripes` for the frames of a chunk, one laser; zero where not `valid`."""

    u: Float[Array, "profiles lines"]
    sigma: Float[Array, "profiles lines"]
    amplitude: Float[Array, "profiles lines"]
    width: Float[Array, "profiles lines"]
    chi2: Float[Array, "profiles lines"]
    skew: Float[Array, "profiles lines"]
    grey: Float[Array, "profiles lines"]
    """Linear level of the laser-off frame at the centre [DN]."""
    saturated: UInt8[Array, "profiles lines"]
    valid: Bool[Array, "profiles lines"]


def prepare_search(
    noise: NoiseModel,
    image_size: tuple[int, int],
    *,
    has_off: bool,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: StripeSettings,
    gate: tuple[np.ndarray, np.ndarray] | None = None,
    near_side: float = 0.0,
) -> Search:
    """What a search needs to know beside the frames.

    Args:
        noise: Noise of a frame.
        image_size: Width and height of a frame [px].
        has_off: Whether there are laser-off frames.
        pixel_format: How a frame is to be read.
        response: "linear" or "srgb".
        line: Which stripe to look for.
        settings: How stripes are found.
        gate: For every line of the image the first pixel that may hold the stripe and the one
            behind the last; the whole line where not given.
        near_side: +1 where what is nearer has the larger centre, else -1.

    Raises:
        ValueError: If the rule of choice needs a side that is not given.
    """
    if settings.choice in ("nearest", "farthest") and near_side == 0:
        raise ValueError(f'choice = "{settings.choice}" needs to know which side is near: reconstruct with a scanner.')
    sites = laser_sites(pixel_format, line)
    across, lines = image_size if line.stripe_axis == "rows" else image_size[::-1]
    low, high = (np.zeros(lines, int), np.full(lines, across)) if gate is None else gate
    whole = lines // sites.pitch * sites.pitch
    plane = np.arange(sites.first_line, whole, sites.line_step)
    offset = np.asarray(sites.offsets)[np.arange(len(plane)) % len(sites.offsets)]
    samples = across // sites.pitch
    first = np.clip((low[plane] - offset) // sites.pitch, 0, samples)
    last = np.clip(-(-(high[plane] - offset) // sites.pitch), 0, samples)
    return Search(
        low=first.astype(np.int32),
        high=last.astype(np.int32),
        thresholds=thresholds(noise, settings, pitch=sites.pitch, has_off=has_off),
        levels=decode_table(response)[0].astype(np.float32),
        read=np.asarray(noise.read_dn, np.float32),
        gain=np.asarray(noise.electrons_per_dn, np.float32),
        log_width=np.zeros((), np.float32),
        width_information=np.zeros((), np.float32),
        near_side=np.asarray(near_side, np.float32),
    )


def learn_search(search: Search, stripes: FrameStripes) -> Search:
    """The search with what its first frames' stripes say of the width."""
    width, sigma, valid = (
        np.asarray(field)[:LEARNED_FRAMES] for field in (stripes.width, stripes.sigma, stripes.valid)
    )
    log_width, information = learn_widths(width, sigma, valid)
    return search._replace(
        log_width=np.asarray(log_width, np.float32), width_information=np.asarray(information, np.float32)
    )


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


_how = ("pixel_format", "response", "line", "settings")
_from_frames = jax.jit(stripes_of_frames, static_argnames=_how)
_from_located = jax.jit(stripes_of_located, static_argnames=("image_size", *_how))
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
        line: Which stripe to look for; a colour "auto" is learned from the frames.
        settings: How stripes are found, chosen and believed.
        noise: Noise of a frame; estimated from the frames where not given.

    Returns:
        Stripes, one profile per frame (`record` counts frames, `laser` is 0), float32. With
        `settings.choice` "all" every frame has three profiles, one after the other.

    Raises:
        ValueError: If shapes or types do not fit the pixel format, the choice needs a scanner, or
            the laser's colour cannot be learned.
    """
    _check(on, off, pixel_format)
    line = with_colour(line, on, off, pixel_format)
    if noise is None:
        noise = estimate_noise(on, off, pixel_format=pixel_format, response=response, line=line)
    size = int(on.shape[2]), int(on.shape[1])
    how: dict[str, Any] = {"pixel_format": pixel_format, "response": response, "line": line, "settings": settings}
    search = prepare_search(noise, size, has_off=off is not None, **how)
    # Single precision throughout, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False):
        search = learn_search(search, _chunk_stripes(on, off, 0, search, **how))
        parts = [_chunk_stripes(on, off, start, search, **how) for start in range(0, len(on), _CHUNK)]
    profiles = len(on) * (CANDIDATES if settings.choice == "all" else 1)
    joined = jax.tree.map(lambda *a: jnp.concatenate(a)[:profiles], *parts)
    fields = {name: field for name, field in joined._asdict().items() if name != "grey"}
    record = np.repeat(np.arange(len(on), dtype=np.int32), profiles // len(on))
    return Stripes(**fields, record=jnp.asarray(record), laser=jnp.zeros(profiles, jnp.int32))


def _chunk_stripes(on: Array, off: Array | None, start: int, search: Search, **how: Any) -> FrameStripes:
    """Stripes of one chunk, in memory of their own."""
    lit = _padded(on[start : start + _CHUNK], len(on))
    dark = None if off is None else _padded(off[start : start + _CHUNK], len(on))
    if dark is not None and is_native(dark):
        look = {name: how[name] for name in ("pixel_format", "line", "settings")}
        located, gain = locate_natively(lit, dark, search, **look)
        size = int(on.shape[2]), int(on.shape[1])
        found = _from_located(located, gain, search, image_size=size, **how)
    else:
        found = _from_frames(lit, dark, search, **how)
    return jax.tree.map(np.array, found)


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
