"""Two projects compared: lengths of the same rooms at two times, or by two versions of the code."""

import contextlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.files.disk import MEGABYTE, parse_json, read_bounded
from jaxscan.project.catalogue import Row, open_catalogue
from jaxscan.project.project import Project
from jaxscan.project.steps import digests_of, states_of, steps_of
from jaxscan.project.work import MEASURES_FORMAT


MOVED_SIGMAS = 3.0
"""Two epochs: a length has changed if it differs by this many standard deviations of the difference."""
MOVED_SHARE = 0.1
"""One capture, two versions: the same points give the same length, so this part of its noise is a change already."""
_LEAST_M = 1e-6


class LengthChange(NamedTuple):
    """A length in two projects."""

    capture: str
    name: str
    """"length", "width" or "height"."""
    first_m: float
    second_m: float
    sigma_m: float
    """Standard deviation of the difference; 0 where both use the same points of one capture."""
    noise_m: float
    """Random part of the length's own standard deviation [m]."""
    same_capture: bool
    moved: bool

    @property
    def difference_m(self) -> float:
        """Second minus first."""
        return self.second_m - self.first_m


class Comparison(NamedTuple):
    """The differences of a second project."""

    lengths: tuple[LengthChange, ...]
    only_first: tuple[str, ...]
    """Captures that only the first names and has measures of."""
    only_second: tuple[str, ...]
    lost: tuple[str, ...]
    """Lengths that the first has and the second has not, of captures that both name: "room-1 height"."""
    gained: tuple[str, ...]
    """Lengths that the second has and the first has not, of captures that both name."""
    stale: tuple[str, ...]
    """Captures whose measures the second project would make anew."""

    @property
    def moved(self) -> tuple[LengthChange, ...]:
        """Lengths that have changed."""
        return tuple(one for one in self.lengths if one.moved)


def compare_projects(first: Project, second: Project) -> Comparison:
    """Compare the measures of the captures that two projects have in common, by their names.

    Of different captures the sigma of a difference is that of both lengths together; a calibration that both share
    would cancel in part, so it is rather too large. One capture gives the same points, so any difference is made by
    the code, the settings or the calibration.

    Raises:
        ConfigError: If one has no measures, or they have no capture, or no length, in common.
    """
    (measures, sources), (others, other_sources) = _measures(first), _measures(second)
    lengths, lost, gained = list[LengthChange](), list[str](), list[str]()
    both = _names(first) & _names(second)
    common = sorted(both & (measures.keys() | others.keys()))
    for name in common:
        ours, theirs = measures.get(name, {}), others.get(name, {})
        same = sources.get(name) is not None and sources.get(name) == other_sources.get(name)
        lengths += [_change(name, side, ours[side], theirs[side], same=same) for side in ours if side in theirs]
        lost += [f"{name} {side}" for side in ours if side not in theirs]
        gained += [f"{name} {side}" for side in theirs if side not in ours]
    if not common:
        raise ConfigError(f"{first.file} and {second.file} have measures of no capture in common; name captures alike.")
    if not lengths and not lost and not gained:
        more = f" and {len(common) - 1} more" if len(common) > 1 else ""
        raise ConfigError(
            f"{first.file} and {second.file}: neither has a length of {common[0]}{more}, for lengths are those of "
            "rooms, of walls that face each other."
        )
    only_first, only_second = sorted(measures.keys() - both), sorted(others.keys() - both)
    return Comparison(
        tuple(lengths), tuple(only_first), tuple(only_second), tuple(lost), tuple(gained), _stale(second, others)
    )


def _names(project: Project) -> set[str]:
    return {capture.name for capture in project.captures}


def _change(
    capture: str, name: str, first: Mapping[str, float], second: Mapping[str, float], *, same: bool
) -> LengthChange:
    noise = max(first["sigma_random_m"], second["sigma_random_m"])
    sigma = 0.0 if same else float(np.hypot(first["sigma_m"], second["sigma_m"]))
    most = max(MOVED_SHARE * noise, _LEAST_M) if same else MOVED_SIGMAS * sigma
    values = first["value_m"], second["value_m"]
    return LengthChange(capture, name, *values, sigma, noise, same, moved=abs(values[1] - values[0]) > most)


def _measures(project: Project) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """The lengths of each capture by their names, and the digest of the capture that they were made of.

    Measures whose renewal failed do not count.

    Raises:
        ConfigError: If there are none.
    """
    last = {row.key: row for row in _rows(project)}
    found, sources = dict[str, dict[str, Any]](), dict[str, str]()
    for name in _names(project):
        row = last.get(f"measures/{name}")
        if row is not None and row.outputs and _is_current(row, last):
            found[name] = _lengths(project.output / row.outputs[0].path)
            cloud = last.get(f"cloud/{name}")
            sources |= {name: cloud.parts["capture"]} if cloud is not None and "capture" in cloud.parts else {}
    if not found:
        raise ConfigError(
            f'{project.file}: has no measures yet; name "measures" among its products, and call: jaxscan batch '
            f"{project.file.name}"
        )
    return found, sources


def _is_current(row: Row, last: Mapping[str, Row]) -> bool:
    """Whether the last attempts of a step and of all steps before it succeeded."""
    before = [last[part] for part in row.parts if part in last]
    same = all(one.digest == row.parts[one.key] for one in before)
    return row.state == "done" and same and all(_is_current(one, last) for one in before)


def _stale(project: Project, measured: Iterable[str]) -> tuple[str, ...]:
    """Captures whose measures would be made anew."""
    steps = steps_of(project)
    states = states_of(steps, *digests_of(steps), _rows(project), project.output)
    done = {status.step.key for status in states if status.state == "done"}
    return tuple(sorted(name for name in measured if f"measures/{name}" not in done))


def _rows(project: Project) -> list[Row]:
    with contextlib.closing(open_catalogue(project, write=False)) as catalogue:
        return catalogue.rows()


def _lengths(path: Path) -> dict[str, Any]:
    about = parse_json(read_bounded(path, MEGABYTE, error=ConfigError), name=str(path), error=ConfigError)
    lengths = about.get("lengths") if isinstance(about, dict) and about.get("format") == MEASURES_FORMAT else None
    keys = ("value_m", "sigma_m", "sigma_random_m")
    good = isinstance(lengths, dict) and all(
        isinstance(side, dict)
        and all(isinstance(side.get(key), int | float) and math.isfinite(side[key]) for key in keys)
        for side in lengths.values()
    )
    if not good or lengths is None:
        raise ConfigError(f"{path}: holds no measures ({json.dumps(MEASURES_FORMAT)}); remove it and call the batch.")
    return dict(lengths)
