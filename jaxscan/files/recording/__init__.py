"""Captures on disk, written."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.recording.folder import LOCK_NAME, require_no_links
    from jaxscan.files.recording.repack import repack_capture
    from jaxscan.files.recording.resume import resume_capture
    from jaxscan.files.recording.store import STORAGES, Storage
    from jaxscan.files.recording.whole import check_new_folder, whole_capture
    from jaxscan.files.recording.writer import CaptureWriter, create_capture
else:
    load_on_use(__name__)
