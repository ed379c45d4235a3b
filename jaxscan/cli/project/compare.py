"""`jaxscan project compare`: the same rooms at two times, or by two versions of the code."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.cli.process.terminal import table
from jaxscan.errors import MeasurementError


if TYPE_CHECKING:
    from jaxscan.project import Comparison, LengthChange


def compare(
    first: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FIRST")],
    second: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SECOND")],
    /,
    *,
    json: JsonTarget = None,
) -> None:
    """Lengths of two epochs or two versions: `jaxscan project compare old/project.toml new/project.toml`.

    Captures with the same name are compared by their measures. Different captures: a length has changed if it differs
    by three standard deviations. The same capture gives the same points, so there a tenth of the length's noise is a
    change already, made by the code, the settings or the calibration. The exit code is 1 if a length has changed, or
    if the second has it no more.

    Args:
        first: The project's file of the first epoch or version.
        second: That of the second.
        json: Write the result as JSON too.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.project import compare_projects, load_project

    check_paths([*file_at("FIRST", first), *file_at("SECOND", second)], file_at("--json", json))
    check_json(json)
    found = compare_projects(load_project(first), load_project(second))
    out = console(json)
    columns = ("", "first m", "second m", "difference mm", "sigma mm", "")
    out.print(table(f"{first} and {second}", columns, [_row(one) for one in found.lengths]))
    if found.stale:
        out.print(f"stale in {second}, so compared as they were made: {', '.join(found.stale)}")
    only_first, only_second = (*found.only_first, *found.lost), (*found.only_second, *found.gained)
    for names, path in ((only_first, first), (only_second, second)):
        if names:
            out.print(f"only in {path}: {', '.join(names)}")
    result = found._asdict() | {
        "lengths": [one._asdict() | {"difference_m": one.difference_m} for one in found.lengths]
    }
    emit_json(json, "project-compare", result)
    changes = _changes(found)
    if changes:
        raise MeasurementError(f"{' and '.join(changes)}.")
    out.print(f"{len(found.lengths)} lengths, none has changed")


def _changes(found: "Comparison") -> list[str]:
    """In words: lengths that have changed, and those that are lost."""
    changes = []
    if found.moved:
        worst = max(found.moved, key=lambda one: abs(one.difference_m))
        changes.append(
            f"{len(found.moved)} of {len(found.lengths)} lengths have changed, {worst.capture} {worst.name} most: by "
            f"{1e3 * worst.difference_m:+.3f} mm"
        )
    if found.lost:
        number = len(found.lost)
        changes.append(f"{number} length{' is' if number == 1 else 's are'} lost: {', '.join(found.lost)}")
    return changes


def _row(one: "LengthChange") -> tuple[str, ...]:
    sigma = "same capture" if one.same_capture else f"{1e3 * one.sigma_m:.2f}"
    name, difference = f"{one.capture} {one.name}", f"{1e3 * one.difference_m:+.3f}"
    return name, f"{one.first_m:.4f}", f"{one.second_m:.4f}", difference, sigma, "changed" if one.moved else ""
