"""Changes of NPZ archives and NPY shards: headers that lie, arrays of other types and shapes, damaged containers."""

import io
import pickle
import random
import warnings
import zipfile
from collections.abc import Callable

import numpy as np

from .nasty import nasty_number, nasty_text
from .texts import change_bytes


def change_npz(rng: random.Random, data: bytes) -> bytes:
    """An archive with one member, or the container, changed."""
    kind = rng.randrange(9)
    if kind == 0:
        return change_bytes(rng, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(one.filename, archive.read(one)) for one in archive.infolist()]
    at = rng.randrange(len(members))
    name, content = members[at]
    compression = zipfile.ZIP_STORED
    match kind:
        case 1:
            del members[at]
        case 2:
            members.append(rng.choice(members))
        case 3:
            members[at] = (
                rng.choice((name + "x", nasty_text(rng).replace("\0", "")[:60000] or "x", "a/b.npy")),
                content,
            )
        case 4:
            members[at] = (name, change_npy_header(rng, content))
        case 5 | 6:
            members[at] = (name, _other_array(rng, content))
        case 7:
            members.append(("extra.npy", _npy(np.zeros(rng.choice((1, 1 << 20, 1 << 26)), np.uint8))))
            compression = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
        case _:
            members[at] = (name, rng.choice((change_bytes(rng, content), pickle.dumps([1]), b"")))
    out = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in members:
            # A name that stands twice is a case of its own, and no matter for a warning here.
            info = zipfile.ZipInfo(name.encode("utf-8", "replace").decode())
            info.compress_type = compression
            archive.filelist.append(info) if not info.filename else archive.writestr(info, content)
    return out.getvalue()


def change_npy_header(rng: random.Random, content: bytes) -> bytes:
    """An NPY file whose header says something else than its data."""
    length = 10 + int.from_bytes(content[8:10], "little")
    header = content[10:length].decode("latin-1", "replace")
    old, new = rng.choice(
        (
            ("'shape': (", "'shape': (7, "),
            ("'shape': (", f"'shape': ({nasty_number(rng)}, "),
            ("'descr': '", "'descr': '>"),
            ("<f8", "<f4"),
            ("<f4", "<f8"),
            ("|u1", "|S0"),
            ("|b1", "|O"),
            ("|u1", "|i1"),
            ("<i4", "<U4"),
            ("False", "True"),
            ("{", "[" * 200),
            ("'fortran_order'", "'x'"),
            ("(", "((((" * 50),
        )
    )
    changed = header.replace(old, new, 1)
    if rng.random() < 0.3:
        changed = "{'descr': '|S0', 'fortran_order': False, 'shape': (1000000000000000,)}"
    text = changed.rstrip().encode("latin-1", "replace")
    text = text.ljust(max(len(text) + 1, length - 10) - 1) + b"\n"
    return content[:8] + min(len(text), 65535).to_bytes(2, "little") + text + content[length:]


def change_shard(rng: random.Random, data: bytes) -> bytes:
    """A shard of frames with another header, another length, or other pixels."""
    match rng.randrange(6):
        case 0:
            return change_npy_header(rng, data)
        case 1:
            return change_bytes(rng, data)
        case 2:
            at = rng.randrange(128, len(data))
            return data[:at] + b"\x80" + data[at:]
        case 3:
            at = rng.randrange(128, len(data))
            return data[:at] + data[at + 1 :]
        case 4:
            frames = np.load(io.BytesIO(data)).copy()
            one, other = rng.randrange(len(frames)), rng.randrange(len(frames))
            frames[[one, other]] = frames[[other, one]]
            return data[:128] + frames.tobytes()
        case _:
            frames = np.load(io.BytesIO(data)).copy()
            one = rng.randrange(len(frames))
            frames[one] = rng.choice((0, 255, np.roll(frames[one], 7), frames[one][::-1], frames[0]))
            return data[:128] + frames.tobytes()


def _other_array(rng: random.Random, content: bytes) -> bytes:
    """The array with other values, another type or another shape; a header that fits."""
    try:
        array = np.load(io.BytesIO(content))
    except (ValueError, OSError):
        return content
    changes: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
        lambda a: a[:-1] if a.ndim else a,
        lambda a: a[..., None],
        lambda a: a.ravel(),
        lambda a: np.concatenate([a, a]) if a.ndim else a,
        lambda a: np.zeros_like(a),
        lambda a: a[:0] if a.ndim else a,
        lambda a: a.astype(rng.choice(("f4", "f8", "i2", "u8", "S3", "U2", "c16", "?", "f2"))),
        lambda a: a.T,
        lambda a: a[::-1] if a.ndim else a,
        lambda a: np.array(nasty_number(rng)),
        lambda a: np.array(nasty_text(rng).replace("\ud800", "?")),
        lambda a: -a if a.dtype.kind == "f" else ~a if a.dtype.kind in "biu" else a,
        lambda a: a * 1e30 if a.dtype.kind == "f" else a,
        lambda a: _one_place(rng, a),
        lambda a: _one_place(rng, a),
        lambda a: _one_place(rng, a),
    )
    with np.errstate(all="ignore"):
        try:
            return _npy(rng.choice(changes)(array))
        except ValueError:
            # A text is no number.
            return content[:-1]


def _one_place(rng: random.Random, array: np.ndarray) -> np.ndarray:
    """One number replaced by one that is nasty."""
    changed = np.array(array)
    if changed.size and changed.dtype.kind in "fiu":
        try:
            changed.flat[rng.randrange(changed.size)] = nasty_number(rng)
        except (OverflowError, ValueError):
            changed.flat[0] = 0
    return changed


def _npy(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=False)
    return out.getvalue()
