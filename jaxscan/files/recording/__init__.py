"""Captures on disk, written."""

from jaxscan.files.recording.folder import LOCK_NAME as LOCK_NAME
from jaxscan.files.recording.folder import make_folder as make_folder
from jaxscan.files.recording.folder import require_no_links as require_no_links
from jaxscan.files.recording.repack import check_new_folder as check_new_folder
from jaxscan.files.recording.repack import repack_capture as repack_capture
from jaxscan.files.recording.resume import resume_capture as resume_capture
from jaxscan.files.recording.store import Storage as Storage
from jaxscan.files.recording.writer import CaptureWriter as CaptureWriter
from jaxscan.files.recording.writer import create_capture as create_capture
