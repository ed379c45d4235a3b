"""The import of a folder of images: planned, its frames decoded, and written as a capture."""

import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import Capture, CaptureHeader, cores, open_capture
from jaxscan.files.disk import MEGABYTE, check, read_bounded
from jaxscan.files.importing.plan import ImportPlan, ImportRequest, PlannedRecord, plan_records
from jaxscan.files.importing.roles import find_roles
from jaxscan.files.importing.sources import Source, list_images, open_video
from jaxscan.files.recording import create_capture, whole_capture
from jaxscan.geometry import MAX_PIXELS
from jaxscan.stripes import DEEP_BITS, ExposurePair, LearnedResponse, learn_response


# The frames that a plan names, decoded: image files by all cores, videos forwards.

if TYPE_CHECKING:
    from jaxscan.vision import Video


class Depth(NamedTuple):
    """The samples of a camera in images of 16 bits."""

    bits: int
    """Bits of a sample of the camera: 8, or one of `DEEP_BITS`."""
    step: int
    """Distance of its levels in the images: more than 1 where they stand at the top of the 16 bits."""
    said: str

    def samples(self, image: np.ndarray, name: str) -> np.ndarray:
        """An image as the camera gave it: uint16, or uint8 of 8 bits."""
        if image.dtype != np.uint16:
            raise CaptureError(f"{name}: found 8 bits, expected 16 like the first image.")
        largest = int(image.max(initial=0))
        if largest > ((1 << self.bits) - 1) * self.step or (self.step > 1 and np.any(image % self.step)):
            raise CaptureError(
                f"{name}: found samples up to {largest}, expected {self.bits} bits in steps of {self.step} as in the "
                "images looked at before; say --bits 10, 12, 14 or 16."
            )
        return (image // self.step).astype(np.uint16 if self.bits > 8 else np.uint8)


def depth_of(images: Iterable[np.ndarray], bits: int | None) -> Depth:
    """Find how images of 16 bits hold the samples of the camera.

    Args:
        images: Some of the images, uint16.
        bits: Bits of the camera's samples, where the user gives them.
    """
    used, largest, stretched = 0, 0, True
    for image in images:
        used |= int(np.bitwise_or.reduce(image, axis=None))
        largest = max(largest, int(image.max(initial=0)))
        stretched = stretched and not np.any(image % 257)
    empty = (used & -used).bit_length() - 1 if used else 0
    if bits is not None:
        if largest < 1 << bits:
            return Depth(bits, 1, f"{bits} bits, as --bits says")
        if empty >= 16 - bits:
            return Depth(bits, 1 << 16 - bits, f"{bits} bits at the top of 16, as --bits says")
        raise OptionError(
            f"--bits {bits}: found samples up to {largest}, expected them below {1 << bits}, or multiples of "
            f"{1 << 16 - bits}."
        )
    if stretched and used:
        return Depth(8, 257, "8 bits: all samples are multiples of 257")
    if empty >= 2:
        found = max(8, -(-(16 - empty) // 2) * 2)
        return Depth(found, 1 << 16 - found, f"{found} bits at the top of 16: the last {empty} are always empty")
    found = next(one for one in DEEP_BITS if largest < 1 << one)
    return Depth(found, 1, f"{found} bits: the largest sample is {largest} (otherwise --bits)")


class FrameKind(NamedTuple):
    """Size and kind of the images, as the first one has them."""

    width: int
    height: int
    rank: int
    """2 for grey or raw Bayer, 3 for colour."""
    compression: str | None
    depth: Depth | None = None
    """How the samples are stored; None for images of 8 bits."""


class FrameReader:
    """Reads the images of a plan; a context manager."""

    def __init__(self, folder: Path, kind: FrameKind | None = None) -> None:
        """`kind` is the kind of the images, if it is known already."""
        self._folder = Path(os.path.abspath(folder))
        self._videos: dict[str, Video] = {}
        self._last: dict[str, tuple[int | None, np.ndarray]] = {}
        self._kind = kind
        self._whole = kind is not None
        """Whether the kind is known for good."""

    def __enter__(self) -> "FrameReader":
        return self

    def __exit__(self, *exception: object) -> None:
        for video in self._videos.values():
            video.close()

    def kind(self, source: Source, others: Sequence[Source], bits: int | None) -> FrameKind:
        """The kind of an image, which all others must have.

        Args:
            source: The image.
            others: Some more images; those of 16 bits help to find the depth.
            bits: Bits of the camera's samples, where the user gives them.
        """
        from jaxscan.vision import is_jpeg

        compression: str | None = "video"
        if source.frame is not None:
            video = open_video(self._folder, source.name)
            image = video.frame(source.frame)
            video.close()
        else:
            data = self._bytes(source, 8 * MAX_PIXELS + MEGABYTE)
            image, compression = self._decoded(data, source), "jpeg" if is_jpeg(data) else None
        self._kind = FrameKind(image.shape[1], image.shape[0], image.ndim, compression)
        if image.dtype == np.uint16:
            more = (self._file(other) for other in others if other.frame is None)
            depth = depth_of(itertools.chain([image], (one for one in more if one.dtype == np.uint16)), bits)
            self._kind = self._kind._replace(depth=depth)
        elif bits is not None:
            raise OptionError(f"--bits {bits}: found 8 bits in {source.name}, expected images of 16 bits.")
        self._whole = True
        return self._kind

    def records(
        self, records: Sequence[PlannedRecord]
    ) -> Iterator[tuple[PlannedRecord, list[np.ndarray], list[np.ndarray]]]:
        """All records with their laser-on and laser-off images, decoded ahead.

        Yields:
            The record, and its images, uint8 [rows, columns(, 3)]; uint16 of cameras with more than 8 bits.
        """
        with ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-import") as pool:
            size = 2 * cores()
            for start in range(0, len(records), size):
                batch = records[start : start + size]
                sources = [source for record in batch for source in (*record.on, *record.off)]
                files = dict.fromkeys(source for source in sources if source.frame is None)
                images = dict(zip(files, pool.map(self._file, files), strict=True))
                # A video is read forwards, and each frame once, so in the order of the numbers.
                for source in sorted({source for source in sources if source.frame is not None}):
                    images[source] = self._frame(source)
                for record in batch:
                    yield record, [images[one] for one in record.on], [images[one] for one in record.off]

    def _file(self, source: Source) -> np.ndarray:
        kind = self._known()
        return self._decoded(self._bytes(source, 8 * kind.width * kind.height + MEGABYTE), source)

    def _frame(self, source: Source) -> np.ndarray:
        kind = self._known()
        if source.name not in self._videos:
            self._videos[source.name] = open_video(self._folder, source.name)
        # A laser-off frame may serve several records.
        last, image = self._last.get(source.name, (None, None))
        if image is None or last != source.frame:
            image = self._videos[source.name].frame(source.frame or 0)
            self._last[source.name] = source.frame, image
        if image.shape[:2] != (kind.height, kind.width) or kind.rank != 3:
            raise CaptureError(
                f"{self._folder / source.name}: found {image.shape[1]} x {image.shape[0]} px in colour, expected "
                f"{kind.width} x {kind.height} px like the first image."
            )
        return image

    def _known(self) -> FrameKind:
        if self._kind is None:
            raise ValueError("`kind` is called before any image is read.")
        return self._kind

    def _bytes(self, source: Source, limit: int) -> bytes:
        return read_bounded(self._folder / source.name, limit, error=CaptureError, links="refuse")

    def _decoded(self, data: bytes, source: Source) -> np.ndarray:
        from jaxscan.vision import decode_image

        name, kind = str(self._folder / source.name), self._kind
        rank, size = (None, None) if kind is None else (kind.rank, kind[:2])
        image = decode_image(data, name=name, rank=rank, size=size, deep=True)
        if kind is not None and kind.depth is not None:
            return kind.depth.samples(image, name)
        if kind is not None and self._whole and image.dtype != np.uint8:
            raise CaptureError(f"{name}: found 16 bits, expected 8 like the first image.")
        return image


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
    """Bits of the camera's samples in images of 16 bits; None: as the images are."""


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
    jpeg = any(name.lower().endswith((".jpg", ".jpeg")) for name in names)
    camera: dict[str, Any] = {
        "width": kind.width,
        "height": kind.height,
        "pixel_format": settings.pixel_format or ("rgb8" if kind.rank == 3 else "mono8"),
        "response": settings.response if learned is None else learned.response,
        "up": settings.up,
        "shutter": settings.shutter,
        "bits": kind.depth.bits if deep and kind.depth is not None else None,
        "compression": kind.compression or ("jpeg" if jpeg else None),
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
