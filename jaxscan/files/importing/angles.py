"""Angles of the table, or positions of a stage: from a step and the numbers in the names, or from a file."""

import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import CaptureError
from jaxscan.files.disk import MEGABYTE, read_bounded


_MOST_DEG = 1e6


class Place(NamedTuple):
    """The table's angle [deg] or the stage's position [mm] in one record, and the placement of the board."""

    value: float | None
    placement: int | None = None


def by_step(keys: Sequence[tuple[int | str, ...]], step: float, unit: str) -> tuple[list[Place], str]:
    """Places from a step.

    Where one number alone changes from name to name, it counts the steps, so that a missing image shifts no angle;
    otherwise, or where the numbers are times, the images follow one another.

    Args:
        keys: The open part of every name, in natural order.
        step: From one image to the next [deg or mm].
        unit: Its unit, for the sentence.

    Returns:
        The places, and a sentence on them.

    Raises:
        CaptureError: If more steps are missing than there are.
    """
    numbers = _counting(keys)
    pace = None if numbers is None else _pace(numbers)
    if numbers is None or pace is None:
        times = "" if numbers is None else f", for the numbers in their names ({numbers[0]} ...) do not count steps"
        steps, said = list(range(len(keys))), "the images follow one another" + times
    else:
        steps = [(number - numbers[0]) // pace for number in numbers]
        missing = steps[-1] + 1 - len(steps)
        if missing > len(steps):
            raise CaptureError(
                f"the numbers in the names go from {numbers[0]} to {numbers[-1]}, and {missing} of {steps[-1] + 1} "
                "steps would be missing: name the images of one scan by --on, or give their places by --angles or "
                "--positions."
            )
        said = "by the numbers in the names" + (f", {missing} of which are missing" if missing else "")
    values = [number * step for number in steps]
    return [Place(value) for value in values], f"{values[0]:g} to {values[-1]:g} {unit} by {step:g}, {said}"


def _pace(numbers: Sequence[int]) -> int | None:
    """The number of counts from step to step; None where the numbers are times, or count no steps."""
    gaps = [after - before for before, after in itertools.pairwise(numbers)]
    clock = [_seconds(number) for number in numbers]
    if all(second is not None for second in clock):
        lengths = [int(after or 0) - int(before or 0) for before, after in itertools.pairwise(clock)]
        # Across a minute a clock leaps by 41 where the numbers of steps would go on.
        if lengths != gaps and max(lengths) - min(lengths) < max(gaps) - min(gaps):
            return None
    pace = math.gcd(*gaps)
    missing = sum(gaps) // pace - len(gaps)
    # Steps have their pace somewhere; times have it nowhere.
    return pace if pace in gaps or 2 * missing <= len(numbers) else None


def _seconds(number: int) -> int | None:
    """The second of a day that a number HHMMSS says, perhaps behind a date; None where it says none."""
    rest, second = divmod(number, 100)
    rest, minute = divmod(rest, 100)
    date, hour = divmod(rest, 100)
    if number < 10_000 or second > 59 or minute > 59 or hour > 23 or not (date == 0 or 19_000_101 <= date < 21_000_000):
        return None
    return 86_400 * date + 3600 * hour + 60 * minute + second


def _counting(keys: Sequence[tuple[int | str, ...]]) -> list[int] | None:
    """The one number that rises from key to key while all else stays; None where there is none."""
    if len(keys) < 2 or len({len(key) for key in keys}) != 1:
        return None
    changing = [at for at in range(len(keys[0])) if len({key[at] for key in keys}) > 1]
    if len(changing) != 1:
        return None
    numbers = [key[changing[0]] for key in keys]
    whole = [number for number in numbers if isinstance(number, int)]
    rising = len(whole) == len(numbers) and all(b > a for a, b in itertools.pairwise(whole))
    # So far apart they are times, not steps.
    return whole if rising and whole[-1] - whole[0] < 100 * len(whole) else None


def by_file(path: Path, names: Sequence[str]) -> tuple[list[Place], str]:
    """Places from a text file: a line for each image, in order or with the image's name first.

    A line holds the angle [deg] or position [mm], "-" where it is not known, and perhaps the number of the board's
    placement, parted by blanks, commas or semicolons. Lines that begin with # are left out.

    Args:
        path: The file.
        names: Names of the images, in natural order.

    Raises:
        CaptureError: With the line that is wrong, or both counts where they differ.
    """
    text = read_bounded(path, MEGABYTE, error=CaptureError).decode("utf-8", "replace")
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    rows = [
        (number, [word for word in re.split(r"[\s,;]+", line) if word])
        for number, line in lines
        if line and not line.startswith("#")
    ]
    named, plain = dict[str, Place](), list[Place]()
    for number, words in rows:
        name = None if _is_angle(words[0]) else words[0]
        values = words if name is None else words[1:]
        if not 1 <= len(values) <= 2 or not _is_angle(values[0]) or not all(one.isdecimal() for one in values[1:]):
            raise CaptureError(
                f"{path}: line {number}: found {' '.join(words)[:60]!r}, expected a number, or an image's name "
                "and a number, and perhaps the number of a placement."
            )
        angle = None if values[0] == "-" else float(values[0])
        place = Place(angle, int(values[1][:9]) if len(values) > 1 else None)
        if name is None:
            plain.append(place)
        else:
            named[name] = place
    if named and plain:
        raise CaptureError(f"{path}: some lines have a name and some have none; expected all or none.")
    if not named:
        if len(plain) != len(names):
            raise CaptureError(f"{path}: found {len(plain)} lines, expected one for each of {len(names)} images.")
        return plain, f"from {path.name}"
    missing = [name for name in names if name not in named and name.rpartition("/")[2] not in named]
    if missing:
        more = f", and for {len(missing) - 1} more images" if len(missing) > 1 else ""
        raise CaptureError(f"{path}: no line for {missing[0]}{more}.")
    return [named.get(name) or named[name.rpartition("/")[2]] for name in names], f"from {path.name}, by name"


def _is_angle(word: str) -> bool:
    if word == "-":
        return True
    try:
        return abs(float(word)) <= _MOST_DEG
    except ValueError:
        return False
