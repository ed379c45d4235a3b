"""What a session leaves on the disk: the journal of a capture, the lock of its folder, the room there is for it."""

from scanrig.recording.ledger import Ledger
from scanrig.recording.lock import FolderLock
from scanrig.recording.space import KEPT_PAIRS, DiskFull, free_bytes, is_full, readable, require_space
