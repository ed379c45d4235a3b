"""A session's files: the journal of a capture, written in the background, the lock of its folder, and free space."""

from scanrig.recording.background import AHEAD, Background
from scanrig.recording.ledger import Ledger
from scanrig.recording.lock import folder_lock
from scanrig.recording.space import KEPT_PAIRS, DiskFull, free_bytes, is_full, readable, require_space
