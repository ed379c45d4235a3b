"""Lossless codecs on frames of a sweep, for `speed.py`: size, and processor time to encode and to decode.

Libraries that are not installed are left out: `pip install imagecodecs` for JPEG-LS, JPEG XL, WebP and others.
"""

import importlib.util
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import cv2
import numpy as np
import zstandard
from measuring.speed_peers import THREADS
from worlds.speed_scene import Frames

from jaxscan.vision import decode_image, encode_png, encode_zstd


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
