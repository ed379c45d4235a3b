"""Sweeps from files, for `speed.py`: PNG, packed frames as the project writes them, and shards, in the page cache.

PNG captures name a few distinct files many times; the others hold every frame. `measure_stored` measures a capture of
any storage in a separate process, so that its memory can be watched.
"""

import argparse
import dataclasses
import json
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from measuring.speed_peers import THREADS, read
from measuring.speed_times import Watch, summary, take_turns
from measuring.tree_jobs import decode_alone
from worlds.speed_scene import HEIGHT, WIDTH, Frames, make_scanner

from jaxscan.files.capture import Capture, cache_path, cached_stripes, frames_key, open_capture, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud, extract, reconstruct
from jaxscan.stripes import Stripes
from jaxscan.vision import encode_png, encode_zstd


HEADER = f"""format = "jaxscan-capture/1"
kind = "sweep"
[camera]
width = {WIDTH}
height = {HEIGHT}
pixel_format = "mono8"
[laser]
name = "laser"
"""
CHUNK = 64
"""Records whose stripes are extracted at a time."""


def write_png_capture(folder: Path, frames: Frames, records: int) -> None:
    """A capture whose records name the same pairs of files in turn."""
    folder.mkdir()
    pairs = len(frames.on)
    for kind, stack in (("on", frames.on), ("off", frames.off)):
        for number, frame in enumerate(stack):
            (folder / f"{kind}{number}.png").write_bytes(encode_png(frame))
    _write_text(folder, records, lambda i: {kind: f"{kind}{i % pairs}.png" for kind in ("on", "off")})


def write_packed_capture(folder: Path, frames: Frames, records: int) -> None:
    """In the storage of new captures, with files of their own for every record."""
    folder.mkdir()
    for kind, stack in (("on", frames.on), ("off", frames.off)):
        packed = [encode_zstd(frame) for frame in stack[:records]]
        for number in range(records):
            (folder / f"{kind}{number}.zst").write_bytes(packed[number % len(packed)])
    _write_text(folder, records, lambda i: {kind: f"{kind}{i}.zst" for kind in ("on", "off")})


def write_shard_capture(folder: Path, frames: Frames, records: int) -> None:
    """A capture of two shards that hold every frame."""
    folder.mkdir()
    for kind, stack in (("on", frames.on), ("off", frames.off)):
        with open(folder / f"{kind}.npy", "wb") as file:
            layout = {"descr": "|u1", "fortran_order": False, "shape": (records, HEIGHT, WIDTH)}
            np.lib.format.write_array_header_1_0(file, layout)
            for start in range(0, records, len(stack)):
                stack[: records - start].tofile(file)
    _write_text(folder, records, lambda i: {kind: f"{kind}.npy#{i}" for kind in ("on", "off")})


def _write_text(folder: Path, records: int, images: Callable[[int], dict[str, str]]) -> None:
    (folder / "capture.toml").write_text(HEADER)
    with open(folder / "frames.jsonl", "w") as journal:
        for i in range(records):
            journal.write(json.dumps({"i": i, "angle_deg": 360.0 * i / records, **images(i)}) + "\n")


def chunks_alone(capture: Capture) -> Callable[[], object]:
    """Let the capture hand out its chunks, and read their bytes, which may still lie in the file."""

    def run() -> None:
        with ThreadPoolExecutor(THREADS) as pool:
            for chunk in capture.chunks(8):
                read(np.asarray(chunk.on), np.asarray(chunk.off), pool)()

    return run


def measure_png(folder: Path, repeats: int) -> dict[str, Any]:
    """Decoding a capture of PNG files, and reconstructing it."""
    capture, scanner = open_capture(folder), make_scanner()
    functions = {
        "decode": decode_alone(capture),
        "chunks": chunks_alone(capture),
        "whole": lambda: reconstruct(capture, scanner),
    }
    return {"records": len(capture), "times": take_turns(functions, repeats)}


def measure_stored(folder: Path, counts: list[int], repeats: int) -> dict[str, Any]:
    """Measure everything on a capture, in a separate process."""
    words = [sys.executable, "-m", "measuring.speed_disk", "--child", str(folder.resolve()), "--repeats", str(repeats)]
    words += ["--counts", ",".join(str(count) for count in counts)]
    experiments = Path(__file__).resolve().parents[1]
    return json.loads(subprocess.run(words, cwd=experiments, stdout=subprocess.PIPE, check=True).stdout)


def _prefix(capture: Capture, count: int) -> Capture:
    return dataclasses.replace(capture, records=capture.records[:count])


def _child(folder: Path, counts: list[int], repeats: int) -> None:
    capture, scanner = open_capture(folder), make_scanner()
    result: dict[str, Any] = {"chunks": summary(*zip(*_timed(chunks_alone(capture), repeats + 1)[1:], strict=True))}
    walls: dict[int, list[float]] = {count: [] for count in counts}
    with Watch() as watch:
        # The first round compiles.
        for turn in range(repeats + 1):
            for count in counts:
                part = _prefix(capture, count)
                start = time.perf_counter()
                cloud = reconstruct(part, scanner)
                if turn > 0:
                    walls[count].append(time.perf_counter() - start)
                points = float(cloud.valid.mean())
                del cloud
    result |= {"walls": walls, "peak_bytes": watch.peak, "points": points}
    stripes = extract(capture, scanner).stripes
    with Watch() as watch:
        runs = _timed(lambda: reconstruct(capture, scanner, stripes=stripes), repeats + 1)[1:]
    result |= {"again": summary(*zip(*runs, strict=True)), "again_peak_bytes": watch.peak}
    fields = {field.name: np.asarray(getattr(stripes, field.name)) for field in dataclasses.fields(stripes)}
    save_stripes(cache_path(capture), fields, {"frames": frames_key(capture)})
    del stripes, fields
    runs = _timed(lambda: _from_cache(capture, scanner), repeats + 1)[1:]
    result |= {"cached": summary(*zip(*runs, strict=True))}
    print(json.dumps(result))


def _from_cache(capture: Capture, scanner: Scanner) -> PointCloud:
    """Cloud from the stripes that are cached beside the capture."""
    kept = cached_stripes(cache_path(capture), {"frames": frames_key(capture)})
    assert kept is not None
    return reconstruct(capture, scanner, stripes=Stripes(**kept))


def _timed(function: Callable[[], object], repeats: int) -> list[tuple[float, float]]:
    runs = []
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        function()
        runs.append((time.perf_counter() - start, time.process_time() - used))
    return runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--child", required=True, metavar="CAPTURE")
    parser.add_argument("--counts", required=True)
    parser.add_argument("--repeats", type=int, required=True)
    options = parser.parse_args()
    _child(Path(options.child), [int(count) for count in options.counts.split(",")], options.repeats)
