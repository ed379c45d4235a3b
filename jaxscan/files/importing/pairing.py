"""Pairs of laser-on and laser-off images: by the open part of their names, or else by their order."""

from collections.abc import Sequence
from typing import NamedTuple

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.importing.listing import Matched


Step = tuple[Matched, ...]
"""The images of one side of a record: one, or one for each exposure."""
_NAMED = 3


class Columns(NamedTuple):
    """Images in the order of the records."""

    on: tuple[tuple[str, tuple[Step, ...]], ...]
    """For each laser its name and its steps, of the same number."""
    off: tuple[Step, ...]
    """One for each step; empty without laser-off images."""
    said: tuple[str, ...]


def pair(on: Sequence[tuple[str, tuple[Matched, ...]]], off: Sequence[tuple[Matched, ...]], exposures: int) -> Columns:
    """Bring all images into the order of the records.

    Args:
        on: Groups of laser-on images, with the names of their lasers; of a bracket, a group for each exposure.
        off: Groups of laser-off images: one, or one for each exposure.
        exposures: Number of exposures; 0 where every image stands alone.

    Raises:
        OptionError: If the numbers of patterns do not fit.
        CaptureError: If images have no partner; with their names.
    """
    if not on:
        if off:
            raise OptionError("--off: found laser-off images without laser-on images; --on names these, or --boards.")
        return Columns((), (), ())
    said: list[str] = []
    if exposures:
        if len(on) != exposures or len(off) not in (0, exposures):
            raise OptionError(
                f"--exposures-ms: found {exposures} exposures, {len(on)} patterns of --on and {len(off)} of --off; "
                "expected a pattern for each exposure."
            )
        lasers = [("", _together([files for _, files in on], "laser-on", said))]
        dark = _together(off, "laser-off", said) if off else ()
    else:
        lasers = [(name, tuple((file,) for file in files)) for name, files in on]
        if len(off) > 1:
            raise OptionError(f"--off: found {len(off)} patterns, expected one, or one for each of --exposures-ms.")
        dark = tuple((file,) for file in off[0]) if off else ()
    first = lasers[0][1]
    ordered = [lasers[0]]
    for name, steps in lasers[1:]:
        ordered.append((name, _follow(first, steps, (lasers[0][0] or "laser on", name or "laser on"), said)))
    if dark:
        # One laser-off image for a whole sweep is one that was taken once.
        if len(dark) == 1 and len(first) > 1:
            said.append(f"{dark[0][0].name} serves as the laser-off image of all {len(first)} steps")
            dark = dark * len(first)
        else:
            dark = _follow(first, dark, ("laser on", "laser off"), said)
    return Columns(tuple(ordered), dark, tuple(dict.fromkeys(said)))


def _together(groups: Sequence[tuple[Matched, ...]], kind: str, said: list[str]) -> tuple[Step, ...]:
    """The exposures of every step."""
    first = tuple((file,) for file in groups[0])
    others = [_follow(first, tuple((file,) for file in group), (kind, kind), said) for group in groups[1:]]
    return tuple(tuple(one[0] for one in step) for step in zip(first, *others, strict=True))


def _follow(first: Sequence[Step], steps: Sequence[Step], kinds: tuple[str, str], said: list[str]) -> tuple[Step, ...]:
    """`steps` in the order of `first`: those with the same open part of the name, or else one after the other."""
    wanted, given = [step[0].key for step in first], {step[0].key: step for step in steps}
    if len(given) == len(steps) and len(set(wanted)) == len(wanted) and set(wanted) == set(given):
        said.append(f"{kinds[1]} images belong to {kinds[0]} images by their names")
        return tuple(given[key] for key in wanted)
    shared = len(set(wanted) & set(given))
    if len(first) == len(steps) and 2 * shared <= len(first):
        said.append(f"{kinds[1]} images belong to {kinds[0]} images by their order, for their names do not tell")
        return tuple(steps)
    alone = [step[0].name for step in first if step[0].key not in given]
    spare = [step[0].name for step in steps if step[0].key not in set(wanted)]
    raise CaptureError(
        f"found {len(first)} {kinds[0]} images and {len(steps)} {kinds[1]} images, expected one of each in every step"
        + (f"; without a partner: {_some(alone)}" if 0 < len(alone) < len(first) else "")
        + (f"; too many: {_some(spare)}" if 0 < len(spare) < len(steps) else "")
        + "; name others by --on and --off, or move the surplus away."
    )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more
