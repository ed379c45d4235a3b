"""Stripes and points on an accelerator: differences from the CPU, and speed as a share of its memory's.

The stacks are in the device's memory from the start. The memory's speed is that of a copy, counted one way: bytes
read over time. The speed of stripes and points, one compiled function, is the bytes of the frames over its time.
Compilation is not timed. A reconstruction of all pairs begins and ends in the host's memory. Smoothing starts and
ends in the host's memory, as in a reconstruction. The results are compared, field by field, with those of the same
function on the CPU, and with the cloud of `reconstruct` as called on this machine.

    python -m experiments.gpu_speed [--dry] [--pairs 1024] [--chunk 128] [--json FILE]

Without an accelerator --dry runs everything on the CPU with few pairs, to see that it works: the
times then mean nothing, and both sides of a difference are computed there.
"""

import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from experiments.report import Figure, command_line, conclude
from experiments.speed_scene import DISTINCT, ELECTRONS_PER_DN, READ_DN, make_angles, make_frames, make_scanner
from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction import FrameChunk, ReconstructSettings, Sweep, plan_sweep, reconstruct
from jaxscan.reconstruction.colours import stripe_colours
from jaxscan.reconstruction.extraction import LEARNED_RECORDS, learn
from jaxscan.reconstruction.points import Aim, Centres, Points, locate_points
from jaxscan.reconstruction.sweep import Batch
from jaxscan.stripes import (
    FrameFormat,
    FrameStripes,
    NoiseModel,
    Smoothed,
    StripeEngine,
    smooth_profiles,
    stripes_of_frames,
)


NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
LIMIT_SHARE = 0.4
"""Of the speed of a copy."""
LIMIT_SIGMAS = 0.1
"""Largest difference of nearly all centres from the CPU's, in their standard deviations."""
NEARLY_ALL = 0.999
LIMIT_ONE_SIDED = 1e-3
"""Share of the stripes that only one of two results may have."""
COPY_BYTES, DRY_COPY_BYTES = 4 << 30, 256 << 20
UNITS = {"u": "px", "sigma": "px", "width": "px", "amplitude": "DN", "grey": "DN", "rgb": "DN", "intensity": "DN"}
UNITS |= {"xyz": "m", "sigma_random": "m", "sigma_systematic": "m", "saturated": "pixels"}


class Chunk(NamedTuple):
    """Pairs of frames, and the table's angles."""

    on: UInt8[Array, "pairs rows columns"]
    off: UInt8[Array, "pairs rows columns"]
    phi: Float[Array, " pairs"]


class Job(NamedTuple):
    """Shared by all chunks."""

    engine: StripeEngine
    aim: Aim


class Finished(NamedTuple):
    """Stripes and their points."""

    stripes: FrameStripes
    points: Points


def prepare(chunk: Chunk, scanner: Scanner, noise: NoiseModel) -> Job:
    """The engine and aim of a reconstruction of a sweep that starts with these pairs; computed on the CPU."""
    sweep = Sweep(chunk.on, chunk.off, chunk.phi.astype(np.float64))
    plan = plan_sweep(sweep, scanner, ReconstructSettings(chunk_records=len(chunk.on)))
    start, whole = FrameChunk(*(frames[:LEARNED_RECORDS] for frames in chunk[:2])), np.arange(len(chunk.on))
    with jax.default_device(jax.devices("cpu")[0]):
        learned = learn(plan, start, noise=noise).taught_by(Batch(whole, 0, chunk.on, chunk.off))
        return Job(learned.engines[0], Aim.of(scanner, plan.settings, plan.stripe_axis))


def points_of_pairs(job: Job, chunk: Chunk) -> Finished:
    """Stripes of all pairs and their points, in one function."""
    stripes = stripes_of_frames(job.engine, chunk.on, chunk.off)
    centres = Centres(stripes.u, stripes.sigma, stripes.valid)
    axis = job.engine.setup.line.stripe_axis
    return Finished(stripes, locate_points(job.aim, centres, chunk.phi, stripe_axis=axis)[0])


def seconds(run: Callable[[], Any], repeats: int) -> float:
    """Least time of a function whose results are waited for, after one run to compile."""
    jax.block_until_ready(run())
    walls = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(run())
        walls.append(time.perf_counter() - start)
    return min(walls)


def copy_bandwidth(device: jax.Device, size: int, repeats: int) -> float:
    """Bytes read per second by a copy from device memory to device memory."""
    source = jax.device_put(jnp.zeros(size // 4, jnp.uint32), device)
    # Something has to change, or there would be nothing to do.
    copy = jax.jit(lambda words: words ^ jnp.uint32(1))
    return size / seconds(lambda: copy(source), repeats)


def resident(chunks: int, size: int, device: jax.Device) -> list[Chunk]:
    """Chunks of the distinct pairs over and over, each in memory of its own on the device."""
    frames = make_frames(min(DISTINCT, chunks * size), make_scanner())
    distinct = [jax.device_put(stack, device) for stack in (frames.on, frames.off)]
    angle = make_angles(chunks * size).astype(np.float32)

    def one(number: int) -> Chunk:
        part = np.arange(number * size, (number + 1) * size)
        frame = jax.device_put(part % len(frames.on), device)
        on, off = (jnp.take(stack, frame, axis=0) for stack in distinct)
        return Chunk(on, off, jax.device_put(angle[part], device))

    return [one(number) for number in range(chunks)]


def differences(name: str, found: dict[str, Any], expected: dict[str, Any]) -> list[Figure]:
    """How far the fields of two results are apart where both are valid, and where only one is."""
    found = {key: np.asarray(field) for key, field in found.items()}
    expected = {key: np.asarray(field) for key, field in expected.items()}
    both = found["valid"] & expected["valid"]
    figures = []
    for key in sorted(found.keys() & expected.keys() - {"valid"}):
        apart = np.abs(found[key][both].astype(np.float64) - expected[key][both].astype(np.float64))
        values = {"largest": apart.max(initial=0.0), "median": np.median(apart) if apart.size else 0.0}
        if key == "u":
            scaled = apart / expected["sigma"][both]
            values["nearly all, in sigmas"] = np.quantile(scaled, NEARLY_ALL) if scaled.size else 0.0
        for kind, value in values.items():
            unit, limit = ("1", LIMIT_SIGMAS) if "sigmas" in kind else (UNITS.get(key, "1"), None)
            figures.append(Figure(f"{name}, {key}: {kind}", float(value), unit, high=limit))
    stripes = max(int(np.count_nonzero(expected["valid"])), 1)
    alone = int(np.count_nonzero(found["valid"] != expected["valid"])) / stripes
    return [
        *figures,
        Figure(f"{name}: valid in both", float(np.count_nonzero(both)), "lines"),
        Figure(f"{name}: valid in one only", alone, "1", high=LIMIT_ONE_SIDED),
    ]


def fields_of(result: Finished) -> dict[str, Any]:
    """The fields of a stripe and of its point by their names; `valid` is the point's."""
    points = result.points._asdict()
    stripes = jax.tree.map(np.asarray, result.stripes)
    # A mono camera's fit knows the grey level already.
    rgb = stripe_colours(stripes, None, FrameFormat(), "rows")
    return {**stripes._asdict(), **points, "rgb": rgb, "intensity": stripes.amplitude}


def measure(device: jax.Device, chunks: int, size: int, copied: int, repeats: int, *, dry: bool) -> list[Figure]:
    """Speed of stripes and points on one device, and how far its results are from the CPU's."""
    scanner = make_scanner()
    bandwidth = copy_bandwidth(device, copied, repeats)
    figures = [Figure("copy, one way", bandwidth / 1e9, "GB/s")]
    stacks = resident(chunks, size, device)
    frame_bytes = sum(chunk.on.nbytes + chunk.off.nbytes for chunk in stacks)
    first = jax.tree.map(lambda leaf: np.asarray(leaf)[:DISTINCT], stacks[0])
    on_host = prepare(first, scanner, NOISE)
    job = jax.device_put(on_host, device)

    def add(name: str, taken: float, limited: bool = False) -> None:
        figures.append(Figure(name, 1e6 * taken / (chunks * size), "us/pair"))
        rate = frame_bytes / taken / bandwidth
        figures.append(Figure(f"{name}: frames' bytes of a copy", rate, "1", low=LIMIT_SHARE if limited else None))

    whole = jax.jit(points_of_pairs)
    # On a CPU the copy says little about what XLA computes there.
    add("stripes and points", seconds(lambda: [whole(job, chunk) for chunk in stacks], repeats), limited=not dry)
    found = whole(job, jax.device_put(first, device))
    stripes = jax.device_get(found.stripes)
    add("smooth", seconds(lambda: smooth(stripes), repeats) * chunks * size / len(first.on))
    every = [np.concatenate([np.asarray(chunk[k]) for chunk in stacks]) for k in range(3)]
    sweep = Sweep(every[0], every[1], every[2].astype(np.float64))
    add("reconstruct, frames in the host's memory", seconds(lambda: reconstruct(sweep, scanner), min(repeats, 3)))
    figures += compare(fields_of(jax.device_get(found)), first, scanner, on_host)
    return figures + differences("smooth - CPU", smoothed(stripes, device), smoothed(stripes, jax.devices("cpu")[0]))


def smooth(stripes: FrameStripes) -> Smoothed:
    """Smooth the centres along the stripe, as a reconstruction does before it triangulates."""
    return smooth_profiles(np.asarray(stripes.u), np.asarray(stripes.sigma), np.asarray(stripes.valid))


def smoothed(stripes: FrameStripes, device: jax.Device) -> dict[str, Any]:
    """The fields of smoothed centres by their names."""
    with jax.default_device(device):
        return {**smooth(stripes)._asdict(), "valid": stripes.valid}


def compare(here: dict[str, Any], first: Chunk, scanner: Scanner, on_host: Job) -> list[Figure]:
    """The first pairs by the function, by the same function on the CPU, and by the public call."""
    with jax.default_device(jax.devices("cpu")[0]):
        there = fields_of(jax.device_get(jax.jit(points_of_pairs)(on_host, first)))
    sweep = Sweep(first.on, first.off, first.phi.astype(np.float64))
    settings = ReconstructSettings(chunk_records=len(first.on), smooth="off")
    cloud = vars(reconstruct(sweep, scanner, settings=settings, noise=NOISE))
    same = {key: cloud[key] for key in ("xyz", "rgb", "intensity", "sigma_random", "sigma_systematic", "valid")}
    return [
        *differences("stripes and points - CPU", here, there),
        *differences("reconstruct - CPU", same, there),
    ]


def main() -> int:
    """Print the figures; exit code 1 if one misses its limit."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--dry", action="store_true", help="on the CPU, few pairs")
    parser.add_argument("--pairs", type=int, default=1024)
    parser.add_argument("--chunk", type=int, default=128, help="pairs per call")
    options = parser.parse_args()
    device = jax.devices("cpu" if options.dry else None)[0]
    if device.platform == "cpu" and not options.dry:
        print("No accelerator is there; --dry runs on the CPU.", file=sys.stderr)
        return 1
    with jax.default_device(device):
        if options.dry:
            figures = measure(device, 2, 8, DRY_COPY_BYTES, 1, dry=True)
        else:
            chunks = max(1, options.pairs // options.chunk)
            figures = measure(device, chunks, options.chunk, COPY_BYTES, 7, dry=False)
    print(f"{device.device_kind} ({device.platform})")
    return conclude("gpu-speed", figures, options.json, device=device.device_kind, dry=options.dry)


if __name__ == "__main__":
    sys.exit(main())
