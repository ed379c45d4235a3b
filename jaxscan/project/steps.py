"""The steps of a project: their graph, digests of what they read, and which results are stale."""

import contextlib
import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jaxscan.errors import CaptureError, ConfigError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME
from jaxscan.files.disk import MEGABYTE, file_digest, read_bounded
from jaxscan.project.catalogue import Catalogue, Row, open_catalogue
from jaxscan.project.config import GroupTable, RigTable
from jaxscan.project.project import Project, ProjectCapture, check_owner


_CAPTURE = ("geometry", "stripes", "vision", "files/capture", "files/calibration", "api")
_SWEEP = (*_CAPTURE, "reconstruction")
_CLOUD = (*_SWEEP, "photographs", "files/clouds")
_CALIBRATION = (*_CAPTURE, "observation", "calibration")
_MEASURES = ("geometry", "measurement", "files/calibration", "files/clouds", "api")
_OF_MERGED = ("geometry", "reconstruction", "files/clouds", "api")
_PLAN = (*_MEASURES, "reconstruction", "drawing", "files/drawings")
_REGISTER = (*_CALIBRATION, "reconstruction", "recalibration", "measurement", "files/known_room")
CODE_OF: Mapping[str, tuple[str, ...]] = {
    "calibration": _CALIBRATION,
    "cloud": _CLOUD,
    "measures": _MEASURES,
    "mesh": (*_MEASURES, "reconstruction", "surface", "files/meshes"),
    "plan": _PLAN,
    "panorama": _CLOUD,
    "report": (*_MEASURES, "reconstruction", "calibration", "drawing", "vision", "report"),
    "recalibration": _REGISTER,
    "register": _REGISTER,
    "station": _CLOUD,
    "merged e57": _OF_MERGED,
    "merged plan": _PLAN,
}
"""Rooms, folders or files, whose code decides a product, beside the one that makes them all: a change elsewhere, of the
viewer say, leaves it as good as it was. Rooms that decide an input already are not named again."""
_AT_A_TIME = 16
"""Sources that are read at the same time: mostly they wait for disks."""
MOST_JOURNAL = 1 << 30


class Step(NamedTuple):
    """One thing to make. It holds names and numbers alone, so that it can be sent to another process."""

    key: str
    """Its name in the catalogue: "cloud/room-01"."""
    kind: str
    inputs: tuple[str, ...]
    """Keys of the steps whose products it reads."""
    sources: Mapping[str, str]
    """Address of each capture and file that it reads and no step makes, by its role: "capture", "calibration"."""
    products: Mapping[str, str]
    """Path of each product that it reads, in the folder of the products, by its role."""
    outputs: tuple[str, ...]
    """The files it writes, in the folder of the products."""
    settings: Mapping[str, Any]


def digests_of(steps: Iterable[Step]) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """The digest of every step, and its parts.

    Args:
        steps: Each after those that it needs.

    Returns:
        digests: By key.
        parts: By key, as `parts_of` gives them.

    A capture that cannot be read has the digest of the reason: its steps fail when they are done, and no others.

    Raises:
        JaxscanError: If a file that many steps read is not there.
    """
    steps = tuple(steps)
    roles = {address: role for step in steps for role, address in step.sources.items()}
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        found = dict(zip(roles, pool.map(_source, roles, roles.values()), strict=True))
    digests: dict[str, str] = {}
    parts: dict[str, dict[str, str]] = {}
    for step in steps:
        parts[step.key] = parts_of(step, found | {key: digests[key] for key in step.inputs}, code_digest(step.kind))
        digests[step.key] = digest_of(step, parts[step.key])
    return digests, parts


@functools.cache
def code_digest(kind: str | None = None) -> str:
    """Digest of the code that makes products of a kind; None for all code of the package."""
    root = Path(str(resources.files("jaxscan")))
    digest = hashlib.sha256()
    rooms = (".",) if kind is None else (*CODE_OF[kind], "project/work")
    # A room is a folder, or one file.
    files = {file for room in rooms for file in (*(root / room).rglob("*.py"), *root.glob(f"{room}.py"))}
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + read_bounded(file, MEGABYTE, error=ConfigError))
    return "sha256:" + digest.hexdigest()


def _source(address: str, role: str) -> str:
    capture = role.startswith(("capture", "boards"))
    try:
        return _capture_digest(address) if capture else file_digest(address, error=ConfigError)
    except CaptureError as problem:
        if not capture:
            raise
        return "sha256:" + hashlib.sha256(f"cannot be read: {problem}".encode(errors="backslashreplace")).hexdigest()


def _capture_digest(folder: str) -> str:
    """A capture by its header and journal, which names the sha256 of every image."""
    digest = hashlib.sha256()
    for name in (HEADER_NAME, JOURNAL_NAME):
        digest.update(file_digest(Path(folder, name), limit=MOST_JOURNAL, error=CaptureError).encode())
    return "sha256:" + digest.hexdigest()


State = Literal["done", "stale", "failed", "missing"]


class Status(NamedTuple):
    """The state of one step."""

    step: Step
    digest: str
    """Digest of the step as it would be done now."""
    parts: Mapping[str, str]
    state: State
    why: str
    """The reason in a few words; the notes of a step that is done."""


def states_of(
    steps: Sequence[Step],
    digests: Mapping[str, str],
    parts: Mapping[str, Mapping[str, str]],
    rows: Sequence[Row],
    output: Path,
) -> list[Status]:
    """The state of every step, in their order.

    Args:
        steps: Each after those that it needs.
        digests: Digest of each step as it would be done now, by key.
        parts: What each depends on, by key.
        rows: Rows of the catalogue, the oldest first.
        output: The folder of the products; each product is looked for, and its size compared.
    """
    now = {(row.key, row.digest): row for row in rows}
    last = {row.key: row for row in rows if row.state != "failed"}
    made = {row.key for row in rows if row.state == "done"}
    found = []
    for step in steps:
        row = now.get((step.key, digests[step.key]))
        state, why = _state(parts[step.key], row, last.get(step.key), output)
        if state == "stale" and step.key not in made:
            state = "missing"
        found.append(Status(step, digests[step.key], parts[step.key], state, why))
    return found


def _state(parts: Mapping[str, str], row: Row | None, last: Row | None, output: Path) -> tuple[State, str]:
    """The state of a step, by the row of its digest and by the last row of any digest that may have written files."""
    if row is not None and row.state == "failed":
        return "failed", row.message
    if last is None:
        return "missing", ""
    if last.state == "begun":
        return "stale", "was begun, and did not come to its end"
    # Another digest, made later, wrote the same files.
    if row is None or last.digest != row.digest:
        return "stale", _changed(parts, last)
    wrong = next((words for one in row.outputs if (words := _wrong(output / one.path, one.size))), "")
    return ("stale", wrong) if wrong else ("done", row.message)


def _wrong(path: Path, size: int) -> str:
    try:
        return "" if os.stat(path).st_size == size else f"{path.name} was changed"
    except OSError:
        return f"{path.name} is gone"


def _changed(parts: Mapping[str, str], last: Row) -> str:
    """The inputs that have changed since it was done last, in words."""
    names = [name for name in parts if parts[name] != last.parts.get(name)]
    names += [name for name in last.parts if name not in parts]
    words = [f"the code, which was version {last.version}" if name == "code" else name for name in names]
    return f"changed: {', '.join(words)}" if words else "was made anew with other inputs"


class Opened(NamedTuple):
    """A project, and where it stands."""

    project: Project
    states: Sequence[Status]
    catalogue: Catalogue


@contextlib.contextmanager
def opened(project: Project, *, write: bool = False) -> Iterator[Opened]:
    """Find which products of a project are there; without `write`, nothing is made.

    Raises:
        JaxscanError: If a capture or the catalogue is not what it should be.
    """
    check_owner(project)
    steps = steps_of(project)
    digests, parts = digests_of(steps)
    with contextlib.closing(open_catalogue(project, write=write)) as catalogue:
        yield Opened(project, states_of(steps, digests, parts, catalogue.rows(), project.output), catalogue)


FORMAT = "jaxscan-step/1"
_FILES = {
    "measures": ("measures/{}.json",),
    "mesh": ("meshes/{}.glb",),
    "plan": ("plans/{}.dxf", "plans/{}.svg"),
    "panorama": ("panoramas/{}.jpg", "panoramas/{}.depth.png", "panoramas/{}.normals.png"),
    "report": ("reports/{}.html",),
}
"""Files of each product that is made of a cloud."""
_OF_CAPTURE: Mapping[str, Callable[[Project, ProjectCapture], Mapping[str, Any]]] = {
    "panorama": lambda project, capture: {"every": capture.settings.every},
    "plan": lambda project, capture: {"project": project.wanted.project.name},
}
"""Settings of products that read the capture too, a plan for its date."""
_MERGED = {"e57": "groups/{}.e57", "plan": "groups/{}.dxf"}


def steps_of(project: Project) -> tuple[Step, ...]:
    """All steps of a project, each after those that it needs.

    Raises:
        ConfigError: If two steps would have one name, or write the same file.
    """
    steps = tuple(_all_steps(project))
    keys, writers = set[str](), dict[str, str]()
    for step in steps:
        if step.key in keys:
            raise ConfigError(f"{project.file}: two steps would be {step.key}; give one of their rigs another name.")
        keys.add(step.key)
        for output in step.outputs:
            # Some disks take two names that differ in their letters' case for one.
            other = writers.setdefault(output.lower(), step.key)
            if other != step.key:
                raise ConfigError(f"{project.file}: {step.key} and {other} would write the same file, {output}.")
    return steps


def _all_steps(project: Project) -> Iterator[Step]:
    rigs = dict.fromkeys(capture.rig for capture in project.captures)
    refined = {rig: _refined(project, rig) for rig in rigs}
    for rig in rigs:
        yield from (*_calibration(project, rig), *refined[rig].steps)
    for capture in project.captures:
        yield from _of_capture(project, capture, refined[capture.rig].by_all)
    for group in project.wanted.group:
        rig = next(one.rig for one in project.captures if one.name in group.captures)
        yield from _of_group(project, group, refined[rig].by_single)


def parts_of(step: Step, digests: Mapping[str, str], code: str) -> dict[str, str]:
    """The inputs of a product, each by a digest: two products with the same parts are the same.

    Args:
        digests: Digests of its inputs, by key, and of its sources, by address.
        code: Digest of the code that does it.

    Returns:
        By the user's names for them: "capture", "calibration", keys of other steps, "settings", "code".
    """
    found = {role: digests[address] for role, address in step.sources.items()}
    found |= {key: digests[key] for key in step.inputs}
    wanted = json.dumps([step.kind, sorted(step.outputs), dict(step.settings)], sort_keys=True, allow_nan=False)
    return found | {"settings": _sha256(wanted), "code": code}


def digest_of(step: Step, parts: Mapping[str, str]) -> str:
    """One digest of a step and of all its parts, "sha256:<hex>"."""
    return _sha256(json.dumps([FORMAT, step.key, dict(parts)], sort_keys=True))


def _sha256(text: str) -> str:
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def _calibration(project: Project, rig: RigTable) -> Iterator[Step]:
    if rig.calibration is None:
        boards = {f"boards {number}": _address(project, place) for number, place in enumerate(rig.boards, 1)}
        yield Step(_key_of(rig), "calibration", (), boards, {}, (_calibration_file(rig), _beside(rig)), {})


class _Reads(NamedTuple):
    """The calibration that a step reads: of a step, or a file."""

    inputs: tuple[str, ...]
    sources: dict[str, str]
    products: dict[str, str]


def _reads(project: Project, rig: RigTable) -> _Reads:
    if rig.calibration is None:
        return _Reads((_key_of(rig),), {}, {"calibration": _calibration_file(rig)})
    return _Reads((), {"calibration": _address(project, rig.calibration)}, {})


class _Refined(NamedTuple):
    """The steps by which the sweeps of a rig refine its calibration, one room after the other."""

    steps: tuple[Step, ...]
    by_single: _Reads
    """Refined by the captures that are in no group. The registration of a group adds its own captures, each once."""
    by_all: _Reads


def _refined(project: Project, rig: RigTable) -> _Refined:
    reads = _reads(project, rig)
    if not rig.recalibrate:
        return _Refined((), reads, reads)
    mine = {one.name: one for one in project.captures if one.rig == rig}
    groups = [group for group in project.wanted.group if group.captures[0] in mine]
    left = set(mine)
    steps = []
    singles = [name for name in mine if not any(name in group.captures for group in groups)]
    for name in singles:
        steps.append(_refining(project, f"{_name_of(rig)}/{name}", [mine[name]], None, reads))
        reads = _Reads((steps[-1].key,), {}, {"calibration": steps[-1].outputs[0]})
    by_single = reads
    left -= set(singles)
    for group in groups:
        # A sweep in two groups is used only once.
        new = [mine[name] for name in group.captures if name in left]
        left -= set(group.captures)
        if new:
            steps.append(_refining(project, f"{_name_of(rig)}/group/{group.name}", new, group.known, reads))
            reads = _Reads((steps[-1].key,), {}, {"calibration": steps[-1].outputs[0]})
    return _Refined(tuple(steps), by_single, reads)


def _refining(project: Project, name: str, captures: list[ProjectCapture], known: str | None, reads: _Reads) -> Step:
    """The calibration, refined by the sweeps of one room."""
    sources = {f"capture {one.name}": one.address for one in captures} | reads.sources
    if known is not None:
        sources["known"] = _address(project, known)
    settings = {"captures": [one.name for one in captures], "every": [one.settings.every for one in captures]}
    output = f"calibrations/{name}.json"
    return Step(f"recalibration/{name}", "recalibration", reads.inputs, sources, reads.products, (output,), settings)


def _address(project: Project, place: str) -> str:
    """A place that the file names, from the root of the disk."""
    return str(Path(project.file.parent, place))


def _name_of(rig: RigTable) -> str:
    """A rig with calibrations for parts of time has a name for each."""
    return rig.name if rig.first is None else f"{rig.name}-{rig.first}"


def _key_of(rig: RigTable) -> str:
    return f"calibration/{_name_of(rig)}"


def _calibration_file(rig: RigTable) -> str:
    return f"calibrations/{_name_of(rig)}.json"


def _beside(rig: RigTable) -> str:
    return f"calibrations/{_name_of(rig)}.npz"


def _of_capture(project: Project, capture: ProjectCapture, reads: _Reads) -> Iterator[Step]:
    name = capture.name
    key, source = f"cloud/{name}", {"capture": capture.address}
    # Later steps read the cloud as PLY, which loses nothing.
    formats = dict.fromkeys(("ply", *capture.formats))
    clouds = tuple(f"clouds/{name}.{suffix}" for suffix in formats)
    settings = capture.settings.model_dump()
    yield Step(key, "cloud", reads.inputs, source | reads.sources, reads.products, clouds, settings)
    for kind, files in _FILES.items():
        if kind in capture.products:
            yield Step(
                f"{kind}/{name}",
                kind,
                (key, *reads.inputs),
                reads.sources | (source if kind in _OF_CAPTURE else {}),
                {"cloud": clouds[0], **reads.products},
                tuple(file.format(name) for file in files),
                _OF_CAPTURE[kind](project, capture) if kind in _OF_CAPTURE else {},
            )


def _of_group(project: Project, group: GroupTable, reads: _Reads) -> Iterator[Step]:
    """Stations are registered, each gives a cloud with the calibration of all, and those are merged one by one."""
    captures = {one.name: one for one in project.captures if one.name in group.captures}
    register, folder = f"register/{group.name}", f"groups/{group.name}"
    sources = {f"capture {name}": captures[name].address for name in group.captures}
    if group.known is not None:
        sources["known"] = _address(project, group.known)
    files = (f"{folder}.calibration.json", f"{folder}.stations.json")
    settings = {"captures": list(group.captures), "every": [captures[name].settings.every for name in group.captures]}
    yield Step(register, "register", reads.inputs, sources | reads.sources, reads.products, files, settings)
    clouds, keys = {}, []
    for number, name in enumerate(group.captures):
        key, clouds[f"cloud {name}"] = f"station/{group.name}/{name}", f"{folder}/{name}.ply"
        of_register = {"calibration": files[0], "stations": files[1]}
        own = {"number": number, **captures[name].settings.model_dump()}
        source = {"capture": captures[name].address}
        yield Step(key, "station", (register,), source, of_register, (clouds[f"cloud {name}"],), own)
        keys.append(key)
    for kind in group.merged:
        output = _MERGED[kind].format(group.name)
        products = {**clouds, "calibration": files[0]}
        more, dated = dict[str, Any](), dict[str, str]()
        if kind == "plan":
            more, dated = {"project": project.wanted.project.name}, {"capture": captures[group.captures[0]].address}
        yield Step(f"merged/{kind}/{group.name}", f"merged {kind}", (*keys, register), dated, products, (output,), more)
