"""The wire, host side: bytes to messages and back (PROTOCOL.md, section 1). Nothing here waits or knows a session."""

import binascii
import re
from dataclasses import dataclass


PROTOCOL = 1
"""The number of the protocol that this host speaks."""

ABORT = b"\x1b"
"""Esc works outside of lines: laser off, no further step, at once. No flipped bit makes it of a byte of a line."""

LONGEST_COMMAND = 96
"""Bytes of a line to the controller, its newline not counted."""

LONGEST_LINE = 127
"""Bytes of a line from the controller, its newline not counted."""

LAST_SEQUENCE = 65535


@dataclass(frozen=True)
class Reply:
    """A command that was carried out, and what it says."""

    seq: int
    fields: dict[str, str]


@dataclass(frozen=True)
class Refusal:
    """A command that came through and was not carried out."""

    seq: int
    code: int


@dataclass(frozen=True)
class Nak:
    """A line of ours came damaged (2) or too long (10): to be sent again. Says not which; it could not be trusted."""

    code: int


@dataclass(frozen=True)
class Event:
    """Something that happened, told once."""

    number: int
    name: str
    fields: dict[str, str]


@dataclass(frozen=True)
class Damaged:
    """A line that is not one of this protocol's, or did not arrive as it was sent."""

    raw: bytes


Message = Reply | Refusal | Nak | Event | Damaged

_SEQ = rb"(0|[1-9][0-9]{0,4})"
_FIELDS = rb"((?: [a-z]+=[!-)+-<>-~]+)*)"
_REPLY = re.compile(rb"=" + _SEQ + rb" ok" + _FIELDS)
_REFUSAL = re.compile(rb"=" + _SEQ + rb" err ([1-9][0-9]?)")
_NAK = re.compile(rb"=\? err ([1-9][0-9]?)")
_EVENT = re.compile(rb"!" + _SEQ + rb" ([A-Z]+)" + _FIELDS)
_SEALED = re.compile(rb"([ -~]*)\*([0-9A-F]{4})")
_VERB = re.compile(r"[A-Z]+")
_KEY = re.compile(r"[a-z]+")


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, from 0xFFFF, no reflection; of "123456789" it is 0x29B1."""
    return binascii.crc_hqx(data, 0xFFFF)


def seal(text: str) -> bytes:
    """A line's text with its CRC and newline, as it goes over the wire."""
    body = text.encode("ascii")
    return b"%s*%04X\n" % (body, crc(body))


def command_text(verb: str, **args: int) -> str:
    """A command as a person would type it: `SHOT to=1200 id=150`.

    Raises:
        ValueError: no verb or key of the protocol's form, or no 32-bit integer: a mistake of the program.
    """
    if not _VERB.fullmatch(verb):
        raise ValueError(f"verb {verb!r}: upper case letters only")
    words = [verb]
    for key, value in args.items():
        if not _KEY.fullmatch(key):
            raise ValueError(f"key {key!r}: lower case letters only")
        if not -(2**31) <= value < 2**31:
            raise ValueError(f"{key}={value}: beyond 32 bits")
        words.append(f"{key}={int(value)}")
    return " ".join(words)


def encode(seq: int, verb: str, **args: int) -> bytes:
    """A command as the bytes of its line.

    Args:
        seq: 1 … 65535.
        verb: upper case.
        args: integers, 32 bits signed; True and False count as 1 and 0.

    Returns:
        The line with CRC and newline.

    Raises:
        ValueError: what this says is no line of the protocol.
    """
    if not 1 <= seq <= LAST_SEQUENCE:
        raise ValueError(f"sequence number {seq}: 1 … {LAST_SEQUENCE}")
    line = seal(f"@{seq} {command_text(verb, **args)}")
    if len(line) - 1 > LONGEST_COMMAND:
        raise ValueError(f"{len(line) - 1} bytes, at most {LONGEST_COMMAND}: {line!r}")
    return line


def next_sequence(seq: int) -> int:
    """The number after seq: after 65535 comes 1."""
    return seq % LAST_SEQUENCE + 1


class LineReader:
    """Puts the controller's lines together from whatever pieces the port hands over."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that are complete with `data`, in order. Never raises, whatever arrives.

        How a stream is cut into pieces changes nothing in what comes out.
        """
        *lines, pending = (self._pending + data.replace(b"\r", b"")).split(b"\n")
        # A line without an end takes no memory without an end: one byte more than the longest tells it apart.
        self._pending = pending[: LONGEST_LINE + 1]
        return [decode(line[: LONGEST_LINE + 1]) for line in lines if line]


def decode(line: bytes) -> Message:
    """One line, without its newline, as a message; `Damaged` for whatever is not exactly one of the protocol's."""
    sealed = _SEALED.fullmatch(line)
    if len(line) > LONGEST_LINE or not sealed or crc(sealed[1]) != int(sealed[2], 16):
        return Damaged(line)
    body = sealed[1]
    if match := _REPLY.fullmatch(body):
        seq, fields = int(match[1]), _fields(match[2])
        return Damaged(line) if fields is None or seq > LAST_SEQUENCE else Reply(seq, fields)
    if match := _EVENT.fullmatch(body):
        number, fields = int(match[1]), _fields(match[3])
        return Damaged(line) if fields is None or number > LAST_SEQUENCE else Event(number, match[2].decode(), fields)
    if match := _REFUSAL.fullmatch(body):
        return Damaged(line) if int(match[1]) > LAST_SEQUENCE else Refusal(int(match[1]), int(match[2]))
    if match := _NAK.fullmatch(body):
        return Nak(int(match[1]))
    return Damaged(line)


def _fields(words: bytes) -> dict[str, str] | None:
    """` a=1 b=2` as a dictionary; None where a key comes twice."""
    pairs = [word.partition("=")[::2] for word in words.decode("ascii").split()]
    fields = dict(pairs)
    return fields if len(fields) == len(pairs) else None
