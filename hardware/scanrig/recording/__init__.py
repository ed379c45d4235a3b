"""What a session leaves on the disk: the journal of a capture, the lock of its folder, the room there is for it."""

from scanrig.recording.ledger import Ledger as Ledger
from scanrig.recording.lock import FolderLock as FolderLock
from scanrig.recording.space import KEPT_PAIRS as KEPT_PAIRS
from scanrig.recording.space import DiskFull as DiskFull
from scanrig.recording.space import free_bytes as free_bytes
from scanrig.recording.space import is_full as is_full
from scanrig.recording.space import readable as readable
from scanrig.recording.space import require_space as require_space
