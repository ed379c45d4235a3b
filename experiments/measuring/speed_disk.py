"""Sweeps from files and lossless codecs, for `speed.py`: PNG, packed frames as the project writes them, and shards.

PNG captures name a few distinct files many times; the others hold every frame. `measure_stored` measures a capture of
any storage in a separate process, so that its memory can be watched. All files are in the page cache."""

import dataclasses
import importlib.util
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import zstandard
from measuring.speed_memory import THREADS, read
from measuring.speed_times import Watch, summary, take_turns
from measuring.tree_jobs import decode_alone
from report import command_line
from worlds.speed_scene import HEIGHT, WIDTH, Frames, make_scanner

from jaxscan.files.capture import Capture, cache_path, cached_stripes, frames_key, open_capture, save_stripes
from jaxscan.geometry import Scanner
from jaxscan.reconstruction import PointCloud, extract, reconstruct
from jaxscan.stripes import Stripes
from jaxscan.vision import decode_image, encode_png, encode_zstd


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
    parser = command_line(__doc__)
    parser.add_argument("--child", required=True, metavar="CAPTURE")
    parser.add_argument("--counts", required=True)
    parser.add_argument("--repeats", type=int, required=True)
    options = parser.parse_args()
    _child(Path(options.child), [int(count) for count in options.counts.split(",")], options.repeats)


class CodecRow(NamedTuple):
    """One codec on one kind of frames; times of a frame on one core, and on all of them [s]."""

    codec: str
    frames: str
    """ "on", "off", "off - on", or "off - the off before"."""
    size: float
    """Share of the raw size."""
    encode: float
    decode: float
    decode_all_cores: float


class _Codec(NamedTuple):
    name: str
    encode: Callable[[np.ndarray], Any]
    decode: Callable[[Any, np.ndarray], np.ndarray]
    """Of the bytes, and memory of the frame's shape that may be used."""


def measure_codecs(frames: Frames, *, count: int = 8, repeats: int = 4) -> list[CodecRow]:
    """A row for each codec and kind of frames; every frame that comes back is compared.

    Differences are taken modulo 256 before encoding and are added again after decoding.
    """
    on, off = frames.on[:count], frames.off[:count]
    kinds = {"on": on, "off": off, "off - on": off - on, "off - the off before": off[1:] - off[:-1]}
    others = {"off - on": on, "off - the off before": off[:-1]}
    cv2.setNumThreads(1)
    try:
        return [
            _row(codec, (name, stack, others.get(name)), repeats)
            for name, stack in kinds.items()
            for codec in _codecs()
            # Differences of frames only where they could be stored.
            if name not in others or codec.name in ("PNG", "zstd of rows' differences", "zstd")
        ]
    finally:
        cv2.setNumThreads(-1)


def _row(codec: _Codec, frames: tuple[str, np.ndarray, np.ndarray | None], repeats: int) -> CodecRow:
    name, stack, added = frames
    packed = [codec.encode(frame) for frame in stack]
    target = np.empty_like(stack)

    def decode(number: int) -> None:
        found = codec.decode(packed[number], target[number])
        if added is not None:
            np.add(found, added[number], out=target[number])
        elif found is not target[number] and not np.shares_memory(found, target[number]):
            target[number] = found

    def decode_all(run: Callable[..., Any]) -> None:
        list(run(decode, range(len(packed))))

    decode_all(map)
    if not np.array_equal(target, stack if added is None else stack + added):
        raise AssertionError(f"{codec.name} has lost something.")
    encoding = _least(lambda: [codec.encode(frame) for frame in stack], repeats, time.process_time)
    decoding = _least(lambda: decode_all(map), repeats, time.process_time)
    with ThreadPoolExecutor(THREADS) as pool:
        together = _least(lambda: decode_all(pool.map), repeats, time.perf_counter)
    size = sum(len(one) for one in packed) / stack.nbytes
    return CodecRow(codec.name, name, size, *(seconds / len(stack) for seconds in (encoding, decoding, together)))


def _least(function: Callable[[], object], repeats: int, clock: Callable[[], float]) -> float:
    found = []
    for _ in range(repeats):
        start = clock()
        function()
        found.append(clock() - start)
    return min(found)


def _codecs() -> Iterator[_Codec]:
    def ours(data: bytes, out: np.ndarray) -> np.ndarray:
        return decode_image(data, name="frame", rank=None, size=None, out=out)

    yield _Codec("zstd of rows' differences", encode_zstd, ours)
    yield _Codec("PNG", encode_png, ours)
    yield _Codec(
        "raw", lambda frame: frame.tobytes(), lambda data, out: np.frombuffer(data, np.uint8).reshape(out.shape)
    )
    yield _Codec("zstd", _zstd, _unzstd)
    yield _Codec("PNG by OpenCV, level 6", _png6, lambda data, _: cv2.imdecode(np.frombuffer(data, np.uint8), -1))
    if importlib.util.find_spec("imagecodecs") is None:
        return
    import imagecodecs as ic

    def columns(frame: np.ndarray) -> np.ndarray:
        return np.concatenate([frame[:, :1], frame[:, 1:] - frame[:, :-1]], 1)

    def summed(data: bytes, out: np.ndarray) -> np.ndarray:
        return np.cumsum(np.frombuffer(data, np.uint8).reshape(out.shape), 1, np.uint8)

    yield _Codec("JPEG-LS", ic.jpegls_encode, lambda data, _: ic.jpegls_decode(data))
    yield _Codec(
        "JPEG XL, effort 1",
        lambda frame: ic.jpegxl_encode(frame, lossless=True, effort=1, numthreads=1),
        lambda data, _: ic.jpegxl_decode(data, numthreads=1),
    )
    yield _Codec(
        "WebP, lossless",
        lambda frame: ic.webp_encode(np.repeat(frame[..., None], 3, 2), lossless=True, level=0, method=0),
        lambda data, _: ic.webp_decode(data)[..., 0],
    )
    yield _Codec(
        "QOI",
        lambda frame: ic.qoi_encode(np.repeat(frame[..., None], 3, 2)),
        lambda data, _: ic.qoi_decode(data)[..., 0],
    )
    yield _Codec(
        "PNG by libspng, level 1", lambda frame: ic.spng_encode(frame, level=1), lambda data, _: ic.spng_decode(data)
    )
    yield _Codec(
        "libdeflate of columns' differences",
        lambda frame: ic.deflate_encode(columns(frame).tobytes(), level=1),
        lambda data, out: summed(ic.deflate_decode(data), out),
    )
    yield _Codec(
        "Rice, blocks of 32 (libaec)",
        lambda frame: ic.aec_encode(frame, bitspersample=8, blocksize=32, flags=ic.AEC.FLAG.DATA_PREPROCESS),
        lambda data, out: np.frombuffer(
            ic.aec_decode(data, bitspersample=8, blocksize=32, flags=ic.AEC.FLAG.DATA_PREPROCESS, out=out.nbytes),
            np.uint8,
        ).reshape(out.shape),
    )
    for library in ("lz4", "zstd"):
        yield _Codec(
            f"blosc2 {library}, bits shuffled, columns' differences",
            lambda frame, library=library: ic.blosc2_encode(
                columns(frame).tobytes(), level=1, compressor=library, shuffle="bitshuffle", typesize=1, numthreads=1
            ),
            lambda data, out: summed(ic.blosc2_decode(data, numthreads=1), out),
        )


def _png6(frame: np.ndarray) -> bytes:
    return cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1].tobytes()


def _zstd(frame: np.ndarray) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(np.ascontiguousarray(frame))


def _unzstd(data: bytes, out: np.ndarray) -> np.ndarray:
    return np.frombuffer(zstandard.ZstdDecompressor().decompress(data), np.uint8).reshape(out.shape)
