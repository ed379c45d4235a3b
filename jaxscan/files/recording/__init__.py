"""Captures on disk, written."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.recording.repack import repack_capture
    from jaxscan.files.recording.store import STORAGES, Storage
    from jaxscan.files.recording.writer import (
        LOCK_NAME,
        CaptureWriter,
        check_new_folder,
        create_capture,
        require_no_links,
        resume_capture,
        whole_capture,
    )
else:
    load_on_use(__name__)
