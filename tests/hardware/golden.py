"""Lines of the protocol that host and firmware are both tested against, byte for byte."""

import binascii
import json
from pathlib import Path
from typing import NamedTuple


DIALOGUES = Path(__file__).resolve().parents[2] / "hardware" / "protocol_vectors.txt"

ENCODED = [
    (1, "HELLO", {"ses": 5}, b"@1 HELLO ses=5*29FC\n"),
    (2, "STAT", {}, b"@2 STAT*C83F\n"),
    (17, "SHOT", {"to": 1200, "id": 150}, b"@17 SHOT to=1200 id=150*0485\n"),
    (
        65535,
        "SHOT",
        {"to": -2147483648, "id": 2147483647, "m": 2},
        b"@65535 SHOT to=-2147483648 id=2147483647 m=2*8306\n",
    ),
    (9, "MOVE", {"to": 0}, b"@9 MOVE to=0*DB9F\n"),
    (10, "LASER", {"on": 1, "ms": 1000}, b"@10 LASER on=1 ms=1000*32A3\n"),
    (11, "LASER", {"on": 0}, b"@11 LASER on=0*31FD\n"),
    (12, "CFG", {"shot": 1}, b"@12 CFG shot=1*DC72\n"),
    (13, "SET", {"vmax": 4000, "vst": 400, "acc": 8000}, b"@13 SET vmax=4000 vst=400 acc=8000*9622\n"),
    (14, "HOME", {"max": 30000}, b"@14 HOME max=30000*B10C\n"),
    (15, "HAS", {}, b"@15 HAS*BE9E\n"),
    (16, "LASER", {"on": 1, "ms": 1000, "n": 2}, b"@16 LASER on=1 ms=1000 n=2*45BB\n"),
    (17, "SHOT", {"to": 1200, "id": 151, "n": 2}, b"@17 SHOT to=1200 id=151 n=2*62F6\n"),
]
"""Sequence number, verb and arguments of commands, and their lines."""


class Step(NamedTuple):
    """What is sent, or an order to the simulated machine after a NUL; and the lines that answer it."""

    sent: bytes
    answer: bytes


def sealed(text):
    """A line with its CRC, computed independently of host and firmware, and its newline."""
    body = text.encode("latin-1")
    return b"%s*%04X\n" % (body, binascii.crc_hqx(body, 0xFFFF))


def dialogues():
    """The steps of each dialogue, by its name."""
    found, steps = {}, []
    for line in DIALOGUES.read_text(encoding="ascii").splitlines():
        mark, _, rest = line.partition(" ")
        match mark:
            case "" | "#":
                continue
            case "ready":
                steps.extend(found["ready"])
            case ">":
                steps.append(Step(sealed(rest), b""))
            case ">>":
                steps.append(Step(json.loads(rest).encode("latin-1"), b""))
            case "!":
                steps.append(Step(b"\0" + rest.encode() + b"\n", b""))
            case "<":
                steps[-1] = steps[-1]._replace(answer=steps[-1].answer + sealed(rest))
            case _:
                assert line[0] + line[-1] == "[]" and line[1:-1] not in found, line
                found[line[1:-1]] = steps = []
    return found
