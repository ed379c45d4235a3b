"""A project, opened for a verb: its steps, their states, and its catalogue."""

import contextlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import tyro


if TYPE_CHECKING:
    from jaxscan.project import Catalogue, Project, Status


ProjectPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PROJECT")]
STATES = ("done", "stale", "failed", "missing")


def project() -> None:
    """Many captures as one project: `jaxscan project init FOLDER` (`jaxscan project --help`)."""


class Opened(NamedTuple):
    """A project, and where it stands."""

    project: "Project"
    states: "Sequence[Status]"
    catalogue: "Catalogue"


@contextlib.contextmanager
def opened(project: "Project", *, write: bool = False) -> Iterator[Opened]:
    """Find what of a project's products is there; without `write`, nothing is made.

    Raises:
        JaxscanError: If a capture or the catalogue is not what it should be.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.project import check_owner, digests_of, open_catalogue, states_of, steps_of

    check_owner(project)
    steps = steps_of(project)
    digests, parts = digests_of(steps)
    catalogue = open_catalogue(project, write=write)
    try:
        yield Opened(project, states_of(steps, digests, parts, catalogue.rows(), project.output), catalogue)
    finally:
        catalogue.close()


def counted(states: "Sequence[Status]") -> dict[str, int]:
    """How many steps are in each state."""
    found = Counter[str](status.state for status in states)
    return {state: found[state] for state in STATES}


def in_words(counts: dict[str, int]) -> str:
    """The counts of states that there are, in a line."""
    return ", ".join(f"{count} {state}" for state, count in counts.items() if count) or "nothing to do"
