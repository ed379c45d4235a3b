"""How many workers a machine has room for, and how much memory each may take, so that it never swaps."""

from typing import NamedTuple

from jaxscan.errors import OptionError


LEAST_GIB = 3.0
"""What a worker should have: a sweep, its compiled code and its products."""
_RESERVE_GIB, _RESERVE_SHARE = 1.0, 0.1
"""What stays free for the caller, the scheduler and the system's cache of files: the larger of both."""
GIB = 1 << 30


class Sizes(NamedTuple):
    """Workers of one machine, and the memory of each [bytes]."""

    workers: int
    memory: int


def sizes_for(workers: int | None, memory_gib: float | None, *, cores: int, free_gib: float) -> Sizes:
    """Share out the free memory of a machine.

    Args:
        workers: As many as are asked for; None for one on each core, fewer if memory is short.
        memory_gib: Memory of each [GiB]; None for equal shares of what is free.
        cores: Cores that may be used.
        free_gib: Memory that is free now [GiB].

    Raises:
        OptionError: If what is asked for does not fit.
    """
    room = free_gib - max(_RESERVE_GIB, _RESERVE_SHARE * free_gib)
    least = LEAST_GIB if memory_gib is None else memory_gib
    fitting = int(max(room, 0.0) / least)
    if workers is None:
        if memory_gib is not None and fitting < 1:
            raise OptionError(f"--memory-gib {memory_gib:g}: {_free(room)}; expected less.")
        workers = max(1, min(cores, fitting))
    elif workers > fitting and (workers > 1 or memory_gib is not None):
        most = max(1, fitting) if memory_gib is None else fitting
        remedy = f"take --workers {most}, or set --memory-gib" if most else "set --memory-gib to less"
        raise OptionError(f"--workers {workers}: {_free(room)}, and {least:g} GiB are needed for each; {remedy}.")
    if memory_gib is None and room < _RESERVE_GIB:
        raise OptionError(
            f"this machine: {_free(room)}, too little for a worker; end other programs, or set --memory-gib."
        )
    each_gib = room / workers if memory_gib is None else memory_gib
    return Sizes(workers, int(each_gib * GIB))


def _free(room: float) -> str:
    return f"{max(room, 0.0):.1f} GiB of memory are free for workers"
