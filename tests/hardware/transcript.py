"""Records the traffic of a link as JSON lines, and replays it without the device."""

import json
from pathlib import Path

from scanrig.clock import Clock, ManualClock, SystemClock
from scanrig.errors import TranscriptDifference
from scanrig.wire import Link

from jaxscan.files.disk import append_whole, open_to_write


class RecordingLink:
    """A link that records its traffic: `{"t": seconds, "write" | "read": text}`, one object per line.

    Each byte is stored as the character with the same number, so that the file is readable. The file is a new one.
    """

    def __init__(self, link: Link, path: Path | str, clock: Clock | None = None):
        self._link = link
        self._clock = clock or SystemClock()
        self._start = self._clock.now()
        self._file = open_to_write(path, "make")

    @property
    def name(self) -> str:
        """The name of the recorded link."""
        return self._link.name

    def write(self, data: bytes) -> None:
        """Send and record the bytes."""
        self._keep("write", data)
        self._link.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Receive and record the bytes."""
        data = self._link.read(timeout_s)
        if data:
            self._keep("read", data)
        return data

    def close(self) -> None:
        """Close link and file."""
        self._link.close()
        self._file.close()

    def _keep(self, action: str, data: bytes) -> None:
        entry = {"t": round(self._clock.now() - self._start, 4), action: data.decode("latin-1")}
        append_whole(self._file, json.dumps(entry).encode() + b"\n", durable=False)


class TranscriptLink:
    """A link that replays a transcript: it answers as the device did and requires the same writes.

    If the transcript has nothing to read, a read waits for its timeout and returns nothing.
    """

    def __init__(self, path: Path | str, clock: Clock | None = None):
        self._name = str(path)
        self._clock = clock or ManualClock()
        self._entries: list[tuple[str, bytes]] = []
        for line in Path(path).read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            action = "write" if "write" in entry else "read"
            self._entries.append((action, entry[action].encode("latin-1")))
        self._next = 0

    @property
    def name(self) -> str:
        """The transcript's path."""
        return self._name

    def write(self, data: bytes) -> None:
        """Compare the bytes with those in the transcript.

        Raises:
            TranscriptDifference: the transcript has other bytes here, or none.
        """
        expected = self._entries[self._next] if self._next < len(self._entries) else ("end", b"")
        if expected != ("write", data):
            raise TranscriptDifference(
                f"{self._name}, entry {self._next + 1}: wrote {data!r}, expected {expected[0]} {expected[1]!r}"
            )
        self._next += 1

    def read(self, timeout_s: float) -> bytes:
        """The bytes in the transcript; b"" if none came before the next write."""
        if self._next < len(self._entries) and self._entries[self._next][0] == "read":
            self._next += 1
            return self._entries[self._next - 1][1]
        self._clock.sleep(timeout_s)
        return b""

    def close(self) -> None:
        """Does nothing; `finish` checks whether all was replayed."""

    def finish(self) -> None:
        """Check that the transcript was replayed to its end.

        Raises:
            TranscriptDifference: entries are left.
        """
        if self._next < len(self._entries):
            action, data = self._entries[self._next]
            raise TranscriptDifference(
                f"{self._name}, entry {self._next + 1}: expected {action} {data!r}, it never came"
            )
