"""Two projects compared: lengths of the same rooms at two times, or by two versions of the code."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.files.disk import MEGABYTE, parse_json, read_bounded
from jaxscan.project.catalogue import Catalogue, Row, catalogue_address
from jaxscan.project.project import Project
from jaxscan.project.work.products import MEASURES_FORMAT


MOVED_SIGMAS = 3.0
"""Two epochs: a length has changed if it differs by so many standard deviations of the difference."""
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
    """Of the difference: 0 of one capture whose points are the same; else of both lengths together."""
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
    """Captures that only the first has measures of."""
    only_second: tuple[str, ...]
    lost: tuple[str, ...]
    """Lengths that the first has and the second has not, of captures that both have: "room-1 height"."""
    gained: tuple[str, ...]
    """Lengths that the second has and the first has not, of captures that both have."""

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
        ConfigError: If one has no measures, or they have no capture in common.
    """
    (measures, sources), (others, other_sources) = _measures(first), _measures(second)
    common = sorted(measures.keys() & others.keys())
    if not common:
        raise ConfigError(f"{first.file} and {second.file} have measures of no capture in common; name captures alike.")
    lengths, lost, gained = list[LengthChange](), list[str](), list[str]()
    for name in common:
        ours, theirs = measures[name]["lengths"], others[name]["lengths"]
        same = sources.get(name) is not None and sources.get(name) == other_sources.get(name)
        lengths += [_change(name, side, ours[side], theirs[side], same=same) for side in ours if side in theirs]
        lost += [f"{name} {side}" for side in ours if side not in theirs]
        gained += [f"{name} {side}" for side in theirs if side not in ours]
    only_first, only_second = sorted(measures.keys() - others.keys()), sorted(others.keys() - measures.keys())
    return Comparison(tuple(lengths), tuple(only_first), tuple(only_second), tuple(lost), tuple(gained))


def _change(
    capture: str, name: str, first: Mapping[str, float], second: Mapping[str, float], *, same: bool
) -> LengthChange:
    noise = max(first["sigma_random_m"], second["sigma_random_m"])
    sigma = 0.0 if same else float(np.hypot(first["sigma_m"], second["sigma_m"]))
    most = max(MOVED_SHARE * noise, _LEAST_M) if same else MOVED_SIGMAS * sigma
    values = first["value_m"], second["value_m"]
    return LengthChange(capture, name, *values, sigma, noise, same, moved=abs(values[1] - values[0]) > most)


def _measures(project: Project) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """The measures of each capture, and the digest of the capture that they were made of."""
    found, sources = {}, {}
    for name, row in _last(project, "measures").items():
        path = project.output / row.outputs[0].path
        found[name] = _checked(path)
    for name, row in _last(project, "cloud").items():
        sources[name] = row.parts.get("capture", "")
    if not found:
        raise ConfigError(
            f'{project.file}: has no measures yet; name "measures" among its products, and call: jaxscan batch '
            f"{project.file.name}"
        )
    return found, sources


def _last(project: Project, kind: str) -> dict[str, Row]:
    """The last row of each capture that was done."""
    wanted = project.wanted.project
    if not wanted.catalogue and not project.output.is_dir():
        return {}
    catalogue = Catalogue(catalogue_address(wanted.catalogue, project.output), wanted.name)
    try:
        rows = catalogue.rows()
    finally:
        catalogue.close()
    own = {f"{kind}/{capture.name}": capture.name for capture in project.captures}
    return {own[row.key]: row for row in rows if row.key in own and row.state == "done"}


def _checked(path: Path) -> dict[str, Any]:
    about = parse_json(read_bounded(path, MEGABYTE, error=ConfigError), name=str(path), error=ConfigError)
    lengths = about.get("lengths") if isinstance(about, dict) and about.get("format") == MEASURES_FORMAT else None
    keys = ("value_m", "sigma_m", "sigma_random_m")
    good = isinstance(lengths, dict) and all(
        isinstance(side, dict) and all(isinstance(side.get(key), int | float) for key in keys)
        for side in lengths.values()
    )
    if not good:
        raise ConfigError(f"{path}: holds no measures ({json.dumps(MEASURES_FORMAT)}); remove it and call the batch.")
    return dict(about)
