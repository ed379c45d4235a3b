"""Plan the import of a folder of images, and write the capture that was planned."""

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import Capture, CaptureHeader, open_capture
from jaxscan.files.disk import check
from jaxscan.files.importing.frames import FrameKind, FrameReader
from jaxscan.files.importing.listing import list_images
from jaxscan.files.importing.plan import ImportPlan, ImportRequest, PlannedRecord, plan_records
from jaxscan.files.importing.roles import find_roles
from jaxscan.files.recording import create_capture, whole_capture
from jaxscan.stripes import ExposurePair, LearnedResponse, learn_response


Progress = Callable[[int, int], None]

LEARN = "learn"
_LEARNED_FROM = 6
_LOOKED_AT = 24
"""Images that say how many bits the camera has."""


@dataclass(frozen=True)
class ImageSettings:
    """Properties of camera, lasers and table that images do not hold."""

    pixel_format: str | None = None
    response: str = "linear"
    """Response of the camera as in a header, or "learn"."""
    shutter: str | None = None
    up: str = "-v"
    laser_colour: str = "auto"
    stripe_axis: str = "rows"
    bits: int | None = None
    """Of the camera's samples in images of 16 bits; None: as the images are."""


class ImportedHeader(NamedTuple):
    """The header of the capture to be written."""

    header: CaptureHeader
    kind: FrameKind
    learned: LearnedResponse | None


def make_plan(folder: Path, request: ImportRequest) -> ImportPlan:
    """Look at a folder's names, and plan the records of its capture.

    Raises:
        OptionError: If an option is missing or does not fit the images.
        CaptureError: If nothing is recognised, or images have no partner.
    """
    if request.every < 1:
        raise OptionError(f"--every: found {request.every}, expected 1 or more.")
    listing = list_images(folder)
    roles = find_roles(folder, listing, request)
    left = listing.others_said()
    return plan_records(folder, roles._replace(said=(*roles.said, left)) if left else roles, request)


def describe_images(plan: ImportPlan, settings: ImageSettings) -> ImportedHeader:
    """The header of the capture, by the first image and, to learn the response, some more.

    Raises:
        CaptureError: If an image cannot be read.
        OptionError: If the response cannot be learned, or a setting does not fit.
    """
    sources = [source for record in plan.records for source in (*record.on, *record.off)]
    first = sources[0]
    names = [source.name for source in sources]
    some = [sources[at] for at in np.unique(np.linspace(0, len(sources) - 1, _LOOKED_AT).astype(int))]
    with FrameReader(plan.folder) as reader:
        kind = reader.kind(first, some, settings.bits)
        deep = kind.depth is not None and kind.depth.bits > 8
        if deep and (settings.response != "linear" or plan.exposures_s):
            option = "--exposures-ms" if plan.exposures_s else f"--response {settings.response}"
            raise OptionError(
                f"{option}: found with images of {kind.depth.bits if kind.depth else 16} bits, which are kept as "
                "levels of 8 bits; expected one exposure and a linear response."
            )
        learned = _learn(plan, reader) if settings.response == LEARN else None
    camera: dict[str, Any] = {
        "width": kind.width,
        "height": kind.height,
        "pixel_format": settings.pixel_format or ("rgb8" if kind.rank == 3 else "mono8"),
        "response": settings.response if learned is None else learned.response,
        "up": settings.up,
        "shutter": settings.shutter,
        "bits": kind.depth.bits if deep and kind.depth is not None else None,
        "compression": kind.compression or ("jpeg" if any(_is_jpeg(name) for name in names) else None),
    }
    rank = 3 if camera["pixel_format"] == "rgb8" else 2
    if rank != kind.rank:
        found = "grey" if kind.rank == 2 else "colour"
        raise OptionError(f"--pixel-format: found {camera['pixel_format']}, but {first} is a {found} image.")
    colour = settings.laser_colour
    if colour == "auto" and not any(record.on and record.off for record in plan.records):
        # A colour is learned from pairs.
        colour = "red"
    look = {"colour": colour, "stripe_axis": settings.stripe_axis}
    tables: dict[str, Any] = {
        "kind": "sweep" if plan.request.board is None else "calibration",
        "camera": camera,
        "laser": [{"name": name, **look} for name in plan.lasers],
        "board": plan.request.board,
        "turntable": None if plan.request.carries is None else {"carries": plan.request.carries},
        "acquisition": {"program": "jaxscan import", "folder": os.path.basename(os.path.abspath(plan.folder))},
    }
    return ImportedHeader(check(CaptureHeader, tables, name="the capture", error=OptionError), kind, learned)


def write_import(plan: ImportPlan, found: ImportedHeader, target: Path, progress: Progress | None = None) -> Capture:
    """Write the capture: images packed without loss, with digests and a seal.

    Args:
        found: Header and kind of the images.
        target: Folder of the capture; it must not exist, and appears only when it is complete.
        progress: Called with (records done, records in all).

    Raises:
        CaptureError: If an image cannot be read or is of another kind, or the target cannot be written. Then nothing
            is left behind.
    """
    linear = plan.request.carries == "linear"
    with whole_capture(target) as part, FrameReader(plan.folder, found.kind) as reader:
        with create_capture(part, found.header, durable=False, digests=True) as writer:
            for done, (record, on, off) in enumerate(reader.records(plan.records), 1):
                writer.append(
                    angle_deg=None if linear else record.place.value,
                    on=_given(on, plan.exposures_s, found),
                    off=_given(off, plan.exposures_s, found),
                    placement=record.place.placement,
                    **_extra(record, linear=linear),
                )
                if progress is not None:
                    progress(done, len(plan.records))
            writer.seal()
    return open_capture(target)


def _is_jpeg(name: str) -> bool:
    return name.lower().endswith((".jpg", ".jpeg"))


def _extra(record: PlannedRecord, *, linear: bool) -> dict[str, Any]:
    """Further keys of a record: the names of its images, its laser, and the position of a stage or a hand."""
    sides = {"on": record.on, "off": record.off}
    extra: dict[str, Any] = {"source": {side: [str(one) for one in images] for side, images in sides.items() if images}}
    if record.laser is not None:
        extra["lasers"] = [record.laser]
    if linear and record.place.value is not None:
        extra["position_m"] = record.place.value / 1000
    if record.place.pose is not None:
        extra["pose"] = list(record.place.pose)
    return extra


def _given(images: list[np.ndarray], exposures_s: tuple[float, ...], found: ImportedHeader) -> Any:
    if not images:
        return None
    return list(zip(images, exposures_s, strict=True)) if exposures_s else images[0]


def _learn(plan: ImportPlan, reader: FrameReader) -> LearnedResponse:
    """The response by the brackets of some records; of laser-off images where there are any."""
    order = np.argsort(plan.exposures_s)
    if len(order) < 2:
        raise OptionError(
            "--response learn: needs images of several exposures: a pattern for each, and --exposures-ms; otherwise "
            "give srgb for the images of a webcam or telephone, and linear for those of a machine vision camera."
        )
    pick = np.unique(np.linspace(0, len(plan.records) - 1, _LEARNED_FROM).astype(int))
    pairs: list[ExposurePair] = []
    for _, on, off in reader.records([plan.records[at] for at in pick]):
        images = off or on
        for short, long in itertools.pairwise(order):
            ratio = plan.exposures_s[long] / plan.exposures_s[short]
            pairs.append(ExposurePair(images[short], images[long], ratio))
    learned = learn_response(pairs)
    if learned is None:
        raise CaptureError(
            f"{plan.folder}: the response cannot be learned: the exposures are too near to one another, or the images "
            "too dark or too bright; give --response linear, srgb or 'gamma 2.2'."
        )
    return learned
