"""The public call: whole stacks of frames to stripes."""

import jax
import jax.numpy as jnp

from jaxscan.geometry import Array
from jaxscan.stripes.engine import prepare_engines
from jaxscan.stripes.frames import FrameFormat, LaserLine, PixelFormat, check_frames, frame_rank
from jaxscan.stripes.predict import predict_off
from jaxscan.stripes.search import ExtractionSetup
from jaxscan.stripes.stripes import KEPT_FIELDS, NoiseModel, Stripes, StripeSettings


_LINE, _SETTINGS = LaserLine(), StripeSettings()
_CHUNK, _BYTES = 16, 2e8
"""Frames per call of the compiled function, and bytes of them at most."""


def extract_stripes(
    on: Array,
    off: Array | None = None,
    *,
    pixel_format: PixelFormat | FrameFormat = "mono8",
    line: LaserLine = _LINE,
    settings: StripeSettings = _SETTINGS,
    noise: NoiseModel | None = None,
) -> Stripes:
    """Sub-pixel centre of the laser's stripe on every line of every frame.

    It compiles itself, takes whole stacks, and has no derivatives: `jax.jit`, `jax.vmap` and `jax.grad` are for what is
    made of its stripes.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3), or a single one without its
            leading axis; NumPy or JAX.
        off: Laser-off frames of the same shape; where there are none, the other channels of a colour
            camera predict them (`predict_off`).
        pixel_format: How a frame is to be read; a `FrameFormat` where its response is not linear.
        line: Which stripe to look for; a colour "auto" is learned from the frames.
        settings: How stripes are found, chosen and believed.
        noise: Noise of a frame; estimated from the frames where not given.

    Returns:
        Stripes, one profile per frame (`record` counts frames, `laser` is 0), float32. With
        `settings.choice` "all" every frame has a profile for each candidate, one after the other.

    Raises:
        TypeError: If it is called within `jax.jit`, `jax.vmap` or `jax.grad`.
        ValueError: If shapes or types do not fit the pixel format, the choice needs a scanner, or
            the laser's colour cannot be learned.
    """
    if isinstance(on, jax.core.Tracer) or isinstance(off, jax.core.Tracer):
        raise TypeError(
            "extract_stripes was called within jax.jit, jax.vmap or jax.grad; call it outside of them, with a stack of "
            "frames: it compiles itself."
        )
    frames = pixel_format if isinstance(pixel_format, FrameFormat) else FrameFormat(pixel_format)
    # A stack of grey frames has as many dimensions as one frame of colours.
    if on.ndim == frame_rank(frames.pixel_format) and (on.ndim == 2 or on.shape[-1] == 3):
        on, off = on[None], off if off is None else off[None]
    check_frames(on, off, frames.pixel_format)
    if len(on) == 0:
        raise ValueError("`on` must hold at least one frame, got none.")
    size = int(on.shape[2]), int(on.shape[1])
    predicted = off is None and frames.pixel_format != "mono8" and line.colour != "auto"
    if predicted:
        off = predict_off(on, frames.pixel_format, line)
    (engine,) = prepare_engines(on, off, [ExtractionSetup(size, frames, line, settings)], noise=noise)
    if predicted:
        engine = engine.own_channel()
    records = max(1, min(_CHUNK, len(on), int(_BYTES / on[0].nbytes)))
    chunks = [slice(start, start + records) for start in range(0, len(on), records)]
    frames_of = lambda part: (on[part], None if off is None else off[part], records)
    engine = engine.learn(*frames_of(chunks[0]))
    found = [engine.extract(*frames_of(part)).stripes for part in chunks]
    each = engine.profiles_per_record
    profiles = each * len(on)
    with jax.enable_x64(False):
        joined = jax.tree.map(lambda *fields: jnp.concatenate(fields), *found)
        fields = {name: getattr(joined, name) for name in KEPT_FIELDS}
        record = jnp.repeat(jnp.arange(len(on), dtype=jnp.int32), each)
        return Stripes(**fields, record=record, laser=jnp.zeros(profiles, jnp.int32))
