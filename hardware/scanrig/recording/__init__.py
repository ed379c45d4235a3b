"""A session's files: the journal of a capture, the lock of its folder, and the free space on the disk."""

from scanrig.recording.ledger import Ledger
from scanrig.recording.lock import FolderLock
from scanrig.recording.space import KEPT_PAIRS, DiskFull, free_bytes, is_full, readable, require_space
