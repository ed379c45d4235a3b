"""The frames of a capture, from image files and shards."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.exposures import exposure_levels, load_levels
from jaxscan.files.capture.header import CaptureHeader, frame_shape, image_limit
from jaxscan.files.capture.journal import Record
from jaxscan.files.capture.references import Folder, ImageRef
from jaxscan.files.capture.seals import difference, frame_digest
from jaxscan.files.capture.shards import Shards
from jaxscan.files.disk import read_bounded
from jaxscan.stripes import frame_rank


class ImageReader:
    """Reads images of one capture; used from several threads."""

    def __init__(self, path: Path, header: CaptureHeader, *, compare: bool = True) -> None:
        self._path, self._header, self._folder = path, header, Folder(path)
        self.compared = compare
        """Whether images are compared with their digests."""
        self.shape = frame_shape(header)
        """Of one image: (rows, columns), or (rows, columns, 3)."""
        self.shards = Shards(path, self.shape)
        self._records: Sequence[Record] = ()

    def check(self, records: Sequence[Record]) -> None:
        """Check that every image exists inside the folder, and that the shards are long enough.

        Raises:
            CaptureError: With the record and the file.
        """
        self._records = records
        located = dict[str, Path]()
        for record, reference in ((one, image) for one in records for image in (*one.on, *one.off)):
            if reference.index is None and self._folder.holds(reference.path):
                continue
            try:
                # Many images share a shard.
                if reference.path not in located:
                    located[reference.path] = self._folder.locate(reference)
                if reference.index is not None:
                    self.shards.check(reference, located[reference.path])
            except CaptureError as problem:
                raise CaptureError(f"{self._path}: record {record.i}: {problem}") from problem

    def image(self, reference: ImageRef, out: np.ndarray | None = None) -> np.ndarray:
        """One image as it is stored, uint8 [rows, columns(, 3)]; a read-only view where it is in a shard.

        Args:
            reference: The image.
            out: Memory of its shape for it, which is used, and returned, where the file has to be decoded.

        Raises:
            CaptureError: With the name of the file that is missing, damaged, of the wrong size, or no longer the one
                whose digest its record holds.
        """
        if reference.index is not None:
            frame = self.shards.image(reference)
            if self.compared and reference.sha256 is not None:
                self._compare(reference, frame_digest(frame))
            return frame
        # Here, so that opening a capture does not load OpenCV.
        from jaxscan.vision import decode_image

        camera = self._header.camera
        name = str(self._path / reference.path)
        try:
            located = self._folder.locate(reference)
        except CaptureError as problem:
            raise CaptureError(f"{self._path}/{problem}") from problem
        data = read_bounded(located, image_limit(self._header), error=CaptureError, links="refuse")
        if self.compared and reference.sha256 is not None:
            self._compare(reference, hashlib.sha256(data).hexdigest())
        size = camera.width, camera.height
        return decode_image(data, name=name, rank=frame_rank(camera.pixel_format), size=size, out=out)

    def _compare(self, reference: ImageRef, digest: str) -> None:
        found = difference(reference, digest)
        if found is None:
            return
        images = ((record.i, one) for record in self._records for one in (*record.on, *record.off))
        number = next((f"record {i}: " for i, one in images if one == reference), "")
        raise CaptureError(
            f"{self._path}: {number}{reference}: {found}; the file has changed since it was written: jaxscan doctor "
            "--capture lists all changes; restore the file from a copy; records of jaxscan scan are taken again by "
            "--resume."
        )

    def frame(self, images: Sequence[ImageRef]) -> np.ndarray | None:
        """One frame of a record, a copy: uint8 [rows, columns(, 3)], of a bracket [exposures, rows, columns(, 3)]."""
        if not images:
            return None
        levels = max(1, len(exposure_levels(images)))
        target = np.empty((levels, *self.shape), np.uint8)
        load_levels(images, target, self.image)
        return target[0] if levels == 1 else target


class RecordFrames:
    """The laser-on, or the laser-off, frames of a sweep: a `FrameSource`."""

    def __init__(self, reader: ImageReader, images: Sequence[tuple[ImageRef, ...]]) -> None:
        """`images` has the images of each record; all records have the same exposures."""
        self._reader = reader
        self._images = images
        self._levels = max(1, len(exposure_levels(images[0]))) if images else 1

    def mapped(self, start: int, stop: int) -> np.ndarray | None:
        """The frames of records start ... stop - 1, a view, where they lie one after another in one shard."""
        if any(len(one) != self._levels for one in self._images[start:stop]):
            return None
        flat = [image for one in self._images[start:stop] for image in _ascending(one)]
        found = self._reader.shards.run(flat)
        if found is None or self._levels == 1:
            return found
        return found.reshape(stop - start, self._levels, *self._reader.shape)

    def examine(self, record: int) -> None:
        """Compare one record's frame, which is mapped, with its digests."""
        for image in self._images[record]:
            if image.sha256 is not None:
                self._reader.image(image)

    def load(self, record: int, target: np.ndarray) -> None:
        """One record's frame into `target`."""
        load_levels(self._images[record], target if self._levels > 1 else target[None], self._reader.image)


def _ascending(images: tuple[ImageRef, ...]) -> Sequence[ImageRef]:
    return images if len(images) == 1 else sorted(images, key=lambda one: one.exposure_s or 0.0)
