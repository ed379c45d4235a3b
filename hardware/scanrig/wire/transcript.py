"""What went over a link, kept as JSON lines, and played again without the device."""

import json
from pathlib import Path
from typing import TextIO

from scanrig.clock import Clock, ManualClock, SystemClock
from scanrig.errors import TranscriptDifference
from scanrig.wire.link import Link


class RecordingLink:
    """A link that writes down what goes over it: `{"t": seconds, "write" | "read": text}`, one object per line.

    Bytes stand as the characters of the same number, so that the file reads as what was said.
    """

    def __init__(self, link: Link, path: Path | str, clock: Clock | None = None):
        self._link = link
        self._clock = clock or SystemClock()
        self._start = self._clock.now()
        self._file: TextIO = open(path, "w", encoding="utf-8")

    @property
    def name(self) -> str:
        """That of the link below."""
        return self._link.name

    def write(self, data: bytes) -> None:
        """Send, and write down what was sent."""
        self._keep("write", data)
        self._link.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Receive, and write down what came."""
        data = self._link.read(timeout_s)
        if data:
            self._keep("read", data)
        return data

    def close(self) -> None:
        """Close link and file."""
        self._link.close()
        self._file.close()

    def _keep(self, what: str, data: bytes) -> None:
        entry = {"t": round(self._clock.now() - self._start, 4), what: data.decode("latin-1")}
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()


class TranscriptLink:
    """A link that plays a transcript: answers as the device did, and insists on being told the same.

    Where the transcript has nothing to read, a read takes its time on the clock and brings nothing.
    """

    def __init__(self, path: Path | str, clock: Clock | None = None):
        self._name = str(path)
        self._clock = clock or ManualClock()
        self._entries: list[tuple[str, bytes]] = []
        for line in Path(path).read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            what = "write" if "write" in entry else "read"
            self._entries.append((what, entry[what].encode("latin-1")))
        self._next = 0

    @property
    def name(self) -> str:
        """The transcript's path."""
        return self._name

    def write(self, data: bytes) -> None:
        """Compare with what was sent then.

        Raises:
            TranscriptDifference: it was something else, or nothing.
        """
        expected = self._entries[self._next] if self._next < len(self._entries) else ("end", b"")
        if expected != ("write", data):
            raise TranscriptDifference(
                f"{self._name}, entry {self._next + 1}: wrote {data!r}, expected {expected[0]} {expected[1]!r}"
            )
        self._next += 1

    def read(self, timeout_s: float) -> bytes:
        """What came then; b"" where nothing did before the next line was sent."""
        if self._next < len(self._entries) and self._entries[self._next][0] == "read":
            self._next += 1
            return self._entries[self._next - 1][1]
        self._clock.sleep(timeout_s)
        return b""

    def close(self) -> None:
        """Nothing to give back; `finish` says whether all was played."""

    def finish(self) -> None:
        """Insist that the transcript was played to its end.

        Raises:
            TranscriptDifference: something is left.
        """
        if self._next < len(self._entries):
            what, data = self._entries[self._next]
            raise TranscriptDifference(f"{self._name}, entry {self._next + 1}: expected {what} {data!r}, it never came")
