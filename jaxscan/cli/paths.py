"""No output of a verb is one of its inputs, or another of its outputs."""

import errno
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxscan.errors import OptionError


class Place(NamedTuple):
    """A file or folder that a verb reads or writes."""

    role: str
    """The option or argument that names it, or another sentence's subject."""
    path: Path
    is_capture: bool = False
    """Whether all files of a capture in it are meant too."""

    def __str__(self) -> str:
        return f"{self.role} {self.path}"


_reads: list[Path] = []


def file_at(role: str, path: Path | str | None) -> list[Place]:
    """A file, or a folder as a whole; nothing where it is not asked for, or is standard output ("-")."""
    return [] if path is None or path == "-" else [Place(role, Path(path))]


def calibration_at(role: str, path: Path | None) -> list[Place]:
    """A calibration, with the file of its observations."""
    if path is None:
        return []
    # Imported here and below, so that `--help` does not load JAX.
    from jaxscan.files.calibration import observations_path

    beside = observations_path(path) if path.name else path
    return [Place(role, path), *([Place(f"the observations of {role},", beside)] if beside != path else [])]


def capture_at(role: str, path: Path | None) -> list[Place]:
    """The folder of a capture."""
    return [] if path is None else [Place(role, path, is_capture=True)]


def check_paths(reads: Sequence[Place], writes: Sequence[Place], *, kept: Sequence[Place] = ()) -> None:
    """Refuse an output that is an input, or another output, also under another name or as a link.

    Args:
        reads: All files that the verb reads.
        writes: All files that it writes; in the folder of a capture that it reads, only files that are not of it.
        kept: Files of the capture itself that the verb writes.

    Raises:
        OptionError: With both names; nothing is changed. Also if a name is none that a disk can have, or if an output
            would follow a link in the folder of a capture: whoever made the capture chose where it leads.
    """
    _reads[:] = [place.path for place in reads]
    known = [(place, _identity(place)) for place in (*reads, *kept)]
    for place in writes:
        identity = _identity(place)
        for other, theirs in known:
            if identity & theirs:
                loss = "which would be lost" if other in reads else "and one of the two would be lost"
                raise OptionError(f"{place}: is the same file as {other}, {loss}; choose another name.")
        for capture in (other for other in reads if other.is_capture):
            if _follows_a_link_in(os.path.realpath(capture.path), place.path, set()):
                raise OptionError(
                    f"{place}: is a link in the folder of a capture, which may lead anywhere; choose another name."
                )
            if _is_of_capture(place.path, identity, capture.path):
                raise OptionError(f"{place}: is a file of the capture {capture}, which would be lost; choose another.")
        known.append((place, identity))
    for place in kept:
        for other in reads:
            if _identity(place) & _identity(other):
                raise OptionError(f"{other}: is the file in which {place.role} are kept; move it to another folder.")


def inputs_in_words() -> str:
    """The inputs of the verb that checked its paths last."""
    return ", ".join(dict.fromkeys(map(str, _reads))) or "the input"


def _identity(place: Place) -> set[object]:
    """Marks that two names of one file share: where links lead, and, for a file that exists, its number on the disk."""
    try:
        found: set[object] = {os.path.realpath(place.path)}
        status = os.stat(place.path)
    except ValueError as problem:
        raise OptionError(f"{place}: is no name that a file can have: {problem}.") from problem
    except OSError as problem:
        if problem.errno == errno.ENAMETOOLONG:
            raise OptionError(f"{place}: the name is longer than the disk allows.") from problem
        return found
    return found | {(status.st_dev, status.st_ino)}


def _follows_a_link_in(folder: str, path: Path, seen: set[Path]) -> bool:
    """Whether a link that lies in a folder is followed on the way to a file, also by way of links elsewhere."""
    for part in (path, *path.parents):
        if part in seen or not os.path.islink(part):
            continue
        seen.add(part)
        if Path(os.path.realpath(part.parent)).is_relative_to(folder):
            return True
        if _follows_a_link_in(folder, part.parent / os.readlink(part), seen):
            return True
    return False


def _is_of_capture(path: Path, identity: set[object], capture: Path) -> bool:
    """Whether a file that is to be written is one of a capture's own."""
    if not capture.is_dir():
        return False
    inside = Path(os.path.realpath(path)).is_relative_to(os.path.realpath(capture))
    # Reading the journal of a large capture takes seconds; a file elsewhere is one of it only by a second name.
    if not inside and not (path.exists() and path.stat().st_nlink > 1):
        return False
    return any(identity & _identity(Place("", file)) for file in _files_of(capture))


def _files_of(capture: Path) -> Iterator[Path]:
    from jaxscan.files.capture import CACHE_NAME, HEADER_NAME, JOURNAL_NAME, read_texts

    for name in (HEADER_NAME, JOURNAL_NAME, CACHE_NAME):
        yield capture / name
    if not (capture / JOURNAL_NAME).is_file():
        return
    for record in read_texts(capture).records:
        for image in (*record.on, *record.off):
            yield capture / image.path
