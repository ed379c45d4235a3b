"""One chunk of a sweep: frames of one laser to stripes, colours and points, in one compiled function."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Int8, UInt8

from jaxscan.geometry import Array
from jaxscan.reconstruction.points.colour import needs_frames, stripe_colours
from jaxscan.reconstruction.points.locate import Centres, Points, Rig, locate_points
from jaxscan.reconstruction.points.triangulate import Limits
from jaxscan.stripes.chunk import candidates_of_located, is_native, locate_frames, locate_natively
from jaxscan.stripes.exposures import merge_exposures
from jaxscan.stripes.frames.formats import LaserLine, PixelFormat, Response, StripeAxis
from jaxscan.stripes.search.candidates import CANDIDATES, Located
from jaxscan.stripes.search.search import Search
from jaxscan.stripes.stripes import FrameStripes, StripeSettings


class ChunkKind(NamedTuple):
    """What a chunk's function is compiled for."""

    image_size: tuple[int, int]
    pixel_format: PixelFormat
    response: Response
    line: LaserLine
    exposures: tuple[float, ...]
    stripes: StripeSettings
    check_steps: bool

    @property
    def profiles_per_frame(self) -> int:
        """Profiles that a frame of one laser gives."""
        return CANDIDATES if self.stripes.choice == "all" or self.check_steps else 1


class Aim(NamedTuple):
    """Where a chunk's points go; arrays, so a change compiles nothing."""

    rig: Rig
    laser: Array
    """Which sheet, int32 []."""
    phi: Array
    """The table's angle of each record [rad from home], float32 [records]."""
    limits: Limits


class ChunkResult(NamedTuple):
    """What a chunk gives."""

    stripes: FrameStripes
    rgb: UInt8[Array, "profiles lines 3"]
    points: Points | None
    chosen: Int8[Array, "records lines"] | None = None
    """Which candidate of every line is the stripe, -1 for none, where steps are still to be checked."""


def compute_chunk(on: Array, off: Array | None, search: Search, aim: Aim | None, kind: ChunkKind) -> ChunkResult:
    """Stripes, colours and, with an aim, points of a chunk of records of one laser.

    On a CPU candidates are found by the native search; elsewhere, and on several devices, all is
    one function of XLA's, the frames shared out among the devices.

    Args:
        on: Laser-on frames, uint8 [records, ...], with a second axis over exposures where there are several.
        off: Laser-off frames of the same shape, or None.
        search: Where to look for stripes.
        aim: Rig, laser and angles; None for stripes and colours only.
        kind: What is compiled.

    Returns:
        NumPy arrays, or arrays on the device.
    """
    if len(kind.exposures) > 1:
        on = on.reshape(-1, *on.shape[2:])
        off = None if off is None else off.reshape(-1, *off.shape[2:])
    if len(jax.local_devices()) > 1:
        return _on_devices(on, off, search, aim, kind=kind)
    if off is None or not is_native(off):
        return _from_frames(on, off, search, aim, kind=kind)
    located, gain = locate_natively(
        on, off, search, pixel_format=kind.pixel_format, line=kind.line, settings=kind.stripes
    )
    seen = off if needs_frames(kind.pixel_format, kind.response) else None
    return _from_located(located, gain, search, seen, aim, kind=kind)


def _all_in_one(on: Array, off: Array | None, search: Search, aim: Aim | None, kind: ChunkKind) -> ChunkResult:
    located, gain = locate_frames(
        on, off, search, pixel_format=kind.pixel_format, line=kind.line, settings=kind.stripes
    )
    return _fit_and_finish(located, gain, search, off, off is not None, aim, kind)


_from_frames = jax.jit(_all_in_one, static_argnames="kind")


@functools.partial(jax.jit, static_argnames="kind")
def _from_located(
    located: Located, gain: Array, search: Search, off: Array | None, aim: Aim | None, *, kind: ChunkKind
) -> ChunkResult:
    return _fit_and_finish(located, gain, search, off, True, aim, kind)


def _fit_and_finish(
    located: Located, gain: Array, search: Search, off: Array | None, has_off: bool, aim: Aim | None, kind: ChunkKind
) -> ChunkResult:
    """Fit, choose, merge exposures, take colours, locate points."""
    stripes, chosen = candidates_of_located(
        located,
        gain,
        search,
        image_size=kind.image_size,
        pixel_format=kind.pixel_format,
        response=kind.response,
        line=kind.line,
        settings=kind.stripes,
        keep=kind.profiles_per_frame > 1,
    )
    chosen = chosen if kind.check_steps else None
    exposures = len(kind.exposures)
    if exposures > 1:
        stripes, chosen = _merged(stripes, chosen, kind)
        # The longest exposure says most about what is dark.
        off = None if off is None else off[exposures - 1 :: exposures]
    rgb = stripe_colours(
        stripes,
        off,
        has_off=has_off,
        pixel_format=kind.pixel_format,
        response=kind.response,
        stripe_axis=kind.line.stripe_axis,
    )
    points = None
    if aim is not None:
        phi = jnp.repeat(aim.phi, kind.profiles_per_frame, total_repeat_length=len(stripes.u))
        points = points_of_centres(
            stripes.u, stripes.sigma, stripes.valid, aim._replace(phi=phi), stripe_axis=kind.line.stripe_axis
        )
    return ChunkResult(stripes, rgb, points, chosen)


def points_of_centres(u: Array, sigma: Array, valid: Array, aim: Aim, *, stripe_axis: StripeAxis) -> Points:
    """Points of stripe centres [profiles, lines], an angle of `aim` for each profile."""
    return locate_points(
        aim.rig,
        Centres(u, sigma, valid),
        jnp.broadcast_to(aim.laser, (len(u),)),
        aim.phi,
        stripe_axis=stripe_axis,
        limits=aim.limits,
    )


points_alone = jax.jit(points_of_centres, static_argnames="stripe_axis")
"""`points_of_centres`, compiled."""


def _merged(stripes: FrameStripes, chosen: Array | None, kind: ChunkKind) -> tuple[FrameStripes, Array | None]:
    """The best exposure of every line, in levels of the first one."""
    exposures, each = len(kind.exposures), kind.profiles_per_frame

    def apart(values):
        # [records * exposures * profiles, lines] to [exposures, records, profiles, lines].
        return jnp.moveaxis(values.reshape(-1, exposures, each, values.shape[1]), 1, 0)

    def together(values):
        return values.reshape(-1, values.shape[2])

    split = jax.tree.map(apart, stripes)
    scale = np.asarray([kind.exposures[0] / one for one in kind.exposures], np.float32)[:, None, None, None]
    split = split._replace(grey=split.grey * scale)
    if chosen is None:
        return jax.tree.map(together, merge_exposures(split, kind.exposures)), None
    # The exposure whose chosen stripe is known best gives all candidates of its line.
    number = jnp.moveaxis(chosen.reshape(-1, exposures, chosen.shape[1]), 1, 0)
    known = number >= 0

    def of_chosen(values):
        return jnp.take_along_axis(values, jnp.maximum(number, 0).astype(jnp.int32)[:, :, None], 2)[:, :, 0]

    fields = {name: of_chosen(getattr(split, name)) for name in ("sigma", "amplitude")}
    which = jnp.broadcast_to(jnp.arange(exposures, dtype=jnp.int32)[:, None, None], known.shape)
    best = merge_exposures({**fields, "valid": known, "which": which, "number": number}, kind.exposures)
    split = split._replace(amplitude=split.amplitude * scale)
    merged = jax.tree.map(lambda values: jnp.take_along_axis(values, best["which"][None, :, None], 0)[0], split)
    return jax.tree.map(together, merged), jnp.where(best["valid"], best["number"], jnp.int8(-1))


def _on_devices(on: Array, off: Array | None, search: Search, aim: Aim | None, *, kind: ChunkKind) -> ChunkResult:
    """All local devices take the same number of frames each."""
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("frames",))
    split = NamedSharding(mesh, PartitionSpec("frames"))
    on, off = jax.device_put(on, split), None if off is None else jax.device_put(off, split)
    return _sharded(mesh, kind)(on, off, search, aim)


@functools.lru_cache(maxsize=16)
def _sharded(mesh: Mesh, kind: ChunkKind):
    frames, everywhere = PartitionSpec("frames"), PartitionSpec()

    def call(on, off, search, where):
        # Every record's angle goes with its frames.
        aim = None if where is None else where._replace(rig=everywhere, laser=everywhere, phi=frames, limits=everywhere)
        specs = (frames, None if off is None else frames, everywhere, aim)
        function = functools.partial(_all_in_one, kind=kind)
        # Every frame is computed by itself: nothing is exchanged.
        return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=frames, check_vma=False)(
            on, off, search, where
        )

    return jax.jit(call)
