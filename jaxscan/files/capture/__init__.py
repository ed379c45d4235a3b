"""Captures on disk, read."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.capture.capture import Capture, common_board, open_capture, refuse_copies
    from jaxscan.files.capture.header import (
        HEADER_NAME,
        BoardTable,
        CameraTable,
        CaptureHeader,
        LaserTable,
        PlanTable,
        TurntableTable,
        frame_shape,
        header_toml,
        load_board,
        parse_header,
    )
    from jaxscan.files.capture.images import ImageReader, cores, exposure_levels
    from jaxscan.files.capture.journal import (
        JOURNAL_NAME,
        MAX_IMAGES,
        MAX_LINE_BYTES,
        Folder,
        ImageRef,
        Record,
        journal_line,
        journal_objects,
        read_texts,
    )
    from jaxscan.files.capture.seals import HEADER_SEAL, SEAL, SEALED_RECORDS, Problem, seal, seal_note, verify_capture
    from jaxscan.files.capture.stripe_cache import (
        CACHE_NAME,
        cache_path,
        cached_stripes,
        code_digest,
        frames_key,
        load_stripes,
        save_stripes,
    )
else:
    load_on_use(__name__)
