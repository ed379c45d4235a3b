"""Stripes and points on an accelerator: equal to the CPU's, and how near to the speed of its memory.

The stacks lie in the device's memory already. Its speed is that of a copy there, counted one way:
bytes read over time. What the stages reach is the frames' bytes over their time; the frames are
all that has to be read once. The choice of a path over the rows, which is sequential by nature, is
reported apart. What is compiled is compiled before the clock starts.

    python experiments/gpu_speed.py [--dry] [--pairs 1024] [--chunk 128] [--json FILE]

Without an accelerator --dry runs everything on the CPU with few pairs, to see that it works.
"""

import argparse
import functools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gpu_stages import STAGES, Chunk, all_of_it, prepare
from speed_scene import DISTINCT, ELECTRONS_PER_DN, READ_DN, make_angles, make_frames, make_scanner
from speed_times import Figure


ASKED_SHARE = 0.4
"""Of the speed of a copy, for all but the path."""
COPY_BYTES, DRY_COPY_BYTES = 4 << 30, 256 << 20
UNITS = {"u": "px", "sigma": "px", "width": "px", "amplitude": "DN", "intensity": "DN", "rgb": "DN", "xyz": "m"}
UNITS |= {"sigma_random": "m", "sigma_systematic": "m", "saturated": "pixels"}


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
    frames = make_frames(DISTINCT, make_scanner())
    distinct = [jax.device_put(stack, device) for stack in (frames.on, frames.off)]
    angle = make_angles(chunks * size).astype(np.float32)

    def one(number: int) -> Chunk:
        part = np.arange(number * size, (number + 1) * size)
        on, off = (jnp.take(stack, jax.device_put(part % DISTINCT, device), axis=0) for stack in distinct)
        return Chunk(on, off, *jax.device_put((np.zeros(size, np.int32), angle[part]), device))

    return [one(number) for number in range(chunks)]


def differences(found: Any, expected: Any) -> list[Figure]:
    """How far every field of a stage's result is from the CPU's where both are valid, and where only one is."""
    kind = type(found).__name__
    valid, other = (np.asarray(result.valid) for result in (found, expected))
    both = valid & other
    figures = []
    for name in found._fields:
        a, b = (np.asarray(getattr(result, name)) for result in (found, expected))
        if a.shape[: both.ndim] != both.shape or name == "valid":
            continue
        apart = np.abs(a[both].astype(np.float64) - b[both].astype(np.float64))
        unit = UNITS.get(name, "1")
        for what, value in (("largest", apart.max(initial=0.0)), ("median", np.median(apart) if apart.size else 0.0)):
            figures.append(Figure(f"{kind}.{name}: {what} difference", float(value), unit, "lower", 1.0))
    return [*figures, Figure(f"{kind}: lines valid on one only", float(np.sum(valid != other)), "lines", "lower", 1.0)]


def measure(device: jax.Device, chunks: int, size: int, copied: int, repeats: int) -> list[Figure]:
    """Speed of the stages on one device, and how far its results are from the CPU's."""
    scanner = make_scanner()
    noise = np.float32(READ_DN), np.float32(ELECTRONS_PER_DN)
    cpu = jax.devices("cpu")[0]
    bandwidth = copy_bandwidth(device, copied, repeats)
    figures = [Figure("copy, one way", bandwidth / 1e9, "GB/s", "higher", 0.1)]
    stacks = resident(chunks, size, device)
    frame_bytes = sum(chunk.on.nbytes + chunk.off.nbytes for chunk in stacks)
    pairs = chunks * size
    rig = prepare(scanner, device)
    total_without_path = 0.0
    inputs: list[Any] = stacks
    for stage in STAGES:
        compiled = jax.jit(functools.partial(stage.run, noise=noise))
        arguments = list(zip(stacks, inputs, strict=True))

        def run(compiled=compiled, arguments=arguments) -> list[Any]:
            return [compiled(rig, chunk, given) for chunk, given in arguments]

        taken = seconds(run, repeats)
        inputs = run()
        if not stage.is_path:
            total_without_path += taken
        figures.append(Figure(f"stage {stage.name}", 1e6 * taken / pairs, "us/pair", "lower", 0.2))
        rate = frame_bytes / taken / bandwidth
        figures.append(Figure(f"stage {stage.name}: frames' bytes of a copy", rate, "1", "higher", 0.2))
    rate = frame_bytes / total_without_path / bandwidth
    figures.append(Figure("all but the path: frames' bytes of a copy", rate, "1", "higher", 0.2, ASKED_SHARE))

    whole = jax.jit(functools.partial(all_of_it, noise=noise))
    taken = seconds(lambda: [whole(rig, chunk) for chunk in stacks], repeats)
    figures.append(Figure("all in one function", 1e6 * taken / pairs, "us/pair", "lower", 0.2))
    rate = frame_bytes / taken / bandwidth
    figures.append(Figure("all in one function: frames' bytes of a copy", rate, "1", "higher", 0.2))

    first = jax.tree.map(lambda leaf: np.asarray(leaf)[:DISTINCT], stacks[0])
    results = []
    for where in (device, cpu):
        with jax.default_device(where):
            results.append(jax.device_get(whole(prepare(scanner, where), jax.device_put(first, where))))
    for found, expected in zip(*results, strict=True):
        figures += differences(found, expected)
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry", action="store_true", help="on the CPU, few pairs")
    parser.add_argument("--pairs", type=int, default=1024)
    parser.add_argument("--chunk", type=int, default=128, help="pairs per call")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file")
    options = parser.parse_args()
    device = jax.devices("cpu" if options.dry else None)[0]
    if device.platform == "cpu" and not options.dry:
        print("No accelerator is there; --dry runs on the CPU.", file=sys.stderr)
        return 1
    with jax.default_device(device):
        if options.dry:
            figures = measure(device, 2, 8, DRY_COPY_BYTES, 2)
        else:
            figures = measure(device, max(1, options.pairs // options.chunk), options.chunk, COPY_BYTES, 7)
    print(f"{device.device_kind} ({device.platform})")
    for figure in figures:
        verdict = {None: "", True: f"asked {figure.asked}: met", False: f"asked {figure.asked}: MISSED"}[figure.met()]
        print(f"{figure.key:>52} {figure.value:12.5g} {figure.unit:8} {verdict}")
    if options.json:
        document = {"format": "jaxscan-experiment-gpu-speed/1", "device": device.device_kind, "dry": options.dry}
        document |= {"metrics": [figure._asdict() for figure in figures]}
        Path(options.json).write_text(json.dumps(document, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
