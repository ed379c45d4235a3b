"""Captures on disk, read."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.capture.board_captures import common_board, refuse_copies
    from jaxscan.files.capture.boards import BoardTable
    from jaxscan.files.capture.capture import Capture, open_capture
    from jaxscan.files.capture.decode import cores
    from jaxscan.files.capture.exposures import exposure_levels
    from jaxscan.files.capture.header import (
        HEADER_NAME,
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
    from jaxscan.files.capture.images import ImageReader
    from jaxscan.files.capture.journal import JOURNAL_NAME, MAX_LINE_BYTES, Record, journal_line, journal_objects
    from jaxscan.files.capture.references import MAX_IMAGES, Folder, ImageRef
    from jaxscan.files.capture.seals import HEADER_SEAL, SEAL, SEALED_RECORDS, seal
    from jaxscan.files.capture.stripe_cache import (
        CACHE_NAME,
        cache_path,
        cached_stripes,
        code_digest,
        frames_key,
        load_stripes,
        save_stripes,
    )
    from jaxscan.files.capture.texts import read_texts
    from jaxscan.files.capture.verify import Problem, seal_note, verify_capture
else:
    load_on_use(__name__)
