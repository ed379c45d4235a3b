"""Changes of NPZ archives and NPY shards: headers that lie, arrays of other types and shapes, damaged containers."""

import io
import pickle
import random
import warnings
import zipfile

import numpy as np

from .nasty import nasty_number, nasty_text, pick
from .texts import change_bytes


def change_npz(rng: random.Random, data: bytes) -> bytes:
    """An archive with one member, or the container, changed."""
    if rng.random() < 0.1:
        return change_bytes(rng, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(one.filename, archive.read(one)) for one in archive.infolist()]
    at = rng.randrange(len(members))
    name, content = members[at]
    strange = rng.choice((name + "x", nasty_text(rng).replace("\0", "")[:60000] or "x", "a/b.npy"))
    bomb = ("extra.npy", _npy(np.zeros(rng.choice((1, 1 << 20, 1 << 26)), np.uint8)))
    members[at : at + 1] = pick(
        rng,
        lambda: [],
        lambda: [members[at], rng.choice(members)],
        lambda: [(strange, content)],
        lambda: [(name, change_npy_header(rng, content))],
        lambda: [(name, _other_array(rng, content))],
        lambda: [(name, _other_array(rng, content))],
        lambda: [members[at], bomb],
        lambda: [(name, rng.choice((change_bytes(rng, content), pickle.dumps([1]), b"")))],
    )
    packed = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    compression = packed if bomb in members else zipfile.ZIP_STORED
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
            *(("'shape': (", "'shape': (7, "), ("'shape': (", f"'shape': ({nasty_number(rng)}, ")),
            *(("'descr': '", "'descr': '>"), ("<f8", "<f4"), ("<f4", "<f8"), ("|u1", "|S0"), ("|b1", "|O")),
            *(("|u1", "|i1"), ("<i4", "<U4"), ("False", "True"), ("{", "[" * 200), ("'fortran_order'", "'x'")),
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
    at, frames = rng.randrange(128, len(data)), np.load(io.BytesIO(data)).copy()
    one, other = rng.randrange(len(frames)), rng.randrange(len(frames))

    def shown(frame: np.ndarray | int) -> bytes:
        frames[one] = frame
        return data[:128] + frames.tobytes()

    return pick(
        rng,
        lambda: change_npy_header(rng, data),
        lambda: change_bytes(rng, data),
        lambda: data[:at] + b"\x80" + data[at:],
        lambda: data[:at] + data[at + 1 :],
        lambda: shown(frames[other].copy()),
        lambda: shown(rng.choice((0, 255, np.roll(frames[one], 7), frames[one][::-1].copy()))),
    )


def _other_array(rng: random.Random, content: bytes) -> bytes:
    """The array with other values, another type or another shape; a header that fits."""
    try:
        a = np.load(io.BytesIO(content))
    except (ValueError, OSError):
        return content
    kind = rng.choice(("f4", "f8", "i2", "u8", "S3", "U2", "c16", "?", "f2"))
    with np.errstate(all="ignore"):
        try:
            changed = pick(
                rng,
                lambda: a[:-1] if a.ndim else a,
                lambda: a[..., None],
                lambda: a.ravel(),
                lambda: np.concatenate([a, a]) if a.ndim else a,
                lambda: np.zeros_like(a),
                lambda: a.astype(kind),
                lambda: a.T,
                lambda: np.array(rng.choice((nasty_number(rng), nasty_text(rng).replace("\ud800", "?")))),
                lambda: -a if a.dtype.kind == "f" else ~a if a.dtype.kind in "biu" else a,
                *[lambda: _one_place(rng, a)] * 4,
            )
            return _npy(changed)
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
