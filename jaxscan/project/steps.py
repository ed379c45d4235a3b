"""The graph of what a project makes: names, what needs what, and by which digests a step is the same as before."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from jaxscan.project.config import RigTable
from jaxscan.project.project import Project, ProjectCapture


FORMAT = "jaxscan-step/1"
_FILES = {"mesh": ("glb",), "plan": ("dxf", "svg"), "panorama": ("jpg",), "report": ("html",)}


class Step(NamedTuple):
    """One thing to make."""

    key: str
    """Its name in the catalogue: "cloud/room-01"."""
    kind: str
    inputs: tuple[str, ...]
    """Keys of the steps whose products it reads."""
    sources: tuple[str, ...]
    """Captures and files that it reads."""
    outputs: tuple[str, ...]
    """What it writes, in the folder of the products."""
    settings: Mapping[str, Any]


def steps_of(project: Project) -> tuple[Step, ...]:
    """All steps of a project, each after those that it needs."""
    steps = {}
    for capture in project.captures:
        for step in (_calibration(project, capture.rig), *_products(project, capture)):
            steps.setdefault(step.key, step)
    return tuple(steps.values())


def digest_of(step: Step, digests: Mapping[str, str], code: str) -> str:
    """By which a step is the same as one that was done: equal inputs, settings and code give equal products.

    Args:
        step: The step.
        digests: Of its inputs, by key, and of its sources, by address.
        code: Digest of the package.

    Returns:
        "sha256:<hex>".
    """
    read = [(name, digests[name]) for name in sorted({*step.inputs, *step.sources})]
    about = [FORMAT, step.key, step.kind, read, sorted(step.outputs), dict(step.settings), code]
    text = json.dumps(about, sort_keys=True, allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def _calibration(project: Project, rig: RigTable) -> Step:
    if rig.calibration is not None:
        # Nothing is made: products depend on the file as it is.
        return Step(_key_of(rig), "calibration", (), (str(project.file.parent / rig.calibration),), (), {})
    boards = tuple(str(project.file.parent / place) for place in rig.boards)
    file = f"calibrations/{_name_of(rig)}"
    return Step(_key_of(rig), "calibration", (), boards, (f"{file}.json", f"{file}.npz"), {})


def _name_of(rig: RigTable) -> str:
    """A rig with calibrations for parts of time has a name for each."""
    return rig.name if rig.first is None else f"{rig.name}-{rig.first}"


def _key_of(rig: RigTable) -> str:
    return f"calibration/{_name_of(rig)}"


def _products(project: Project, capture: ProjectCapture) -> Iterator[Step]:
    wanted, name = project.wanted.project, capture.name
    source, cloud = str(capture.path), f"cloud/{name}"
    # What is made of a cloud reads it as PLY, which loses nothing.
    formats = dict.fromkeys(("ply", *wanted.formats))
    outputs = tuple(f"clouds/{name}.{suffix}" for suffix in formats)
    yield Step(cloud, "cloud", (_key_of(capture.rig),), (source,), outputs, capture.settings.model_dump())
    for kind, suffixes in _FILES.items():
        if kind in wanted.products:
            files = tuple(f"{kind}s/{name}.{suffix}" for suffix in suffixes)
            sources = (source,) if kind == "panorama" else ()
            yield Step(f"{kind}/{name}", kind, (cloud, _key_of(capture.rig)), sources, files, {})
