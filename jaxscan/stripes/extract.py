"""The public call: whole stacks of frames to stripes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import Array
from jaxscan.stripes.chunk import is_native, locate_natively, stripes_of_frames, stripes_of_located
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response, frame_rank
from jaxscan.stripes.frames.learn_colour import with_colour
from jaxscan.stripes.frames.noise import estimate_noise
from jaxscan.stripes.search.candidates import CANDIDATES
from jaxscan.stripes.search.search import Search, learn_search, prepare_search
from jaxscan.stripes.stripes import FrameStripes, NoiseModel, Stripes, StripeSettings


_LINE, _SETTINGS = LaserLine(), StripeSettings()
_CHUNK = 16
"""Frames per call of the compiled function."""

_how = ("pixel_format", "response", "line", "settings")
_from_frames = jax.jit(stripes_of_frames, static_argnames=_how)
_from_located = jax.jit(stripes_of_located, static_argnames=("image_size", *_how))


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
        if settings.learn_width:
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
