"""A disk that is full, folders that cannot be written: while a case runs."""

import contextlib
import ctypes
import os
import resource
import stat
from collections.abc import Iterator
from pathlib import Path


_VERSION = 0x20080522
"""Of the structures of capget and capset: two words for each of the three sets."""
_OVERRIDE = 1 << 1 | 1 << 2
"""CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH: with them root writes where nobody may."""


@contextlib.contextmanager
def hardship(most_bytes: int | None, read_only: tuple[Path, ...]) -> Iterator[None]:
    """Until the end of `with` no file grows beyond `most_bytes`, and folders cannot be written, by root neither.

    A file that may not grow fails in the same place as one on a full disk, also in libraries of C.
    """
    with contextlib.ExitStack() as stack:
        if most_bytes is not None:
            soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
            stack.callback(resource.setrlimit, resource.RLIMIT_FSIZE, (soft, hard))
        for folder in read_only:
            mode = stat.S_IMODE(folder.stat().st_mode)
            folder.chmod(mode & ~0o222)
            stack.callback(folder.chmod, mode)
        if read_only and os.geteuid() == 0:
            stack.enter_context(_as_others())
        yield


@contextlib.contextmanager
def _as_others() -> Iterator[None]:
    """Take root's right to write everywhere from this thread, and from those that it starts."""
    head = (ctypes.c_uint32 * 2)(_VERSION, 0)
    sets = (ctypes.c_uint32 * 6)()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.capget(head, sets) != 0:
        raise OSError(ctypes.get_errno(), "capget")
    lesser = (ctypes.c_uint32 * 6)(*sets)
    lesser[0] &= ~_OVERRIDE
    if libc.capset(head, lesser) != 0:
        raise OSError(ctypes.get_errno(), "capset")
    try:
        yield
    finally:
        libc.capset(head, sets)
