"""Notes beside compiled code on disk, which say that the code for some kind of work is there."""

import contextlib
import hashlib
from collections.abc import Hashable
from importlib import metadata
from pathlib import Path

import jax

from jaxscan.errors import OutputError
from jaxscan.files.disk import write_atomically


_COMPILERS = ("jaxscan", "jax", "jaxlib", "equinox", "numba")


def is_kept(kind: Hashable) -> bool:
    """Whether the code for a kind of work, told by its `repr`, was compiled with these versions and kept on disk."""
    note = _note(kind)
    return note is not None and note.exists()


def remember(kind: Hashable) -> None:
    """Note that it is; without a cache on disk, nothing."""
    note = _note(kind)
    # A cache that cannot be written to is no fault of the work.
    with contextlib.suppress(OutputError):
        if note is not None:
            text = f"compiled and kept here: {kind!r}\n"
            write_atomically(note, text.encode(), durable=False, error=OutputError, links="replace")


def cache_on_disk() -> str | None:
    """The folder of compiled code; None where it is not kept."""
    return jax.config.values["jax_compilation_cache_dir"] or None


def _note(kind: Hashable) -> Path | None:
    folder = cache_on_disk()
    if folder is None:
        return None
    versions = [f"{name} {metadata.version(name)}" for name in _COMPILERS]
    words = repr((kind, versions, jax.default_backend()))
    return Path(folder) / f"compiled-{hashlib.sha256(words.encode()).hexdigest()[:16]}"
