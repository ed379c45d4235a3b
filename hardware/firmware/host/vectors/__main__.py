"""Writes hardware/protocol_vectors.json: lines that both sides must send, with independently computed CRCs.

    python hardware/firmware/host/vectors

The answers below are written by hand from PROTOCOL.md. None is what the firmware happened to say.
"""

import json
from pathlib import Path

import lines
import two_lasers
import work
from dialogue import sealed


OUT = Path(__file__).resolve().parents[3] / "protocol_vectors.json"

DIALOGUES = {**lines.DIALOGUES, **work.DIALOGUES, **two_lasers.DIALOGUES}

ENCODE = [
    (1, "HELLO", {"ses": 5}),
    (2, "STAT", {}),
    (17, "SHOT", {"to": 1200, "id": 150}),
    (65535, "SHOT", {"to": -2147483648, "id": 2147483647, "m": 2}),
    (9, "MOVE", {"to": 0}),
    (10, "LASER", {"on": 1, "ms": 1000}),
    (11, "LASER", {"on": 0}),
    (12, "CFG", {"shot": 1}),
    (13, "SET", {"vmax": 4000, "vst": 400, "acc": 8000}),
    (14, "HOME", {"max": 30000}),
    (15, "HAS", {}),
    (16, "LASER", {"on": 1, "ms": 1000, "n": 2}),
    (17, "SHOT", {"to": 1200, "id": 151, "n": 2}),
]

PARSE = [
    ("=17 ok", {"kind": "reply", "seq": 17, "fields": {}}),
    ("=1 ok proto=1 fw=1.0.0 boot=17 lease=1000 buf=96",
     {"kind": "reply", "seq": 1, "fields": {"proto": "1", "fw": "1.0.0", "boot": "17", "lease": "1000", "buf": "96"}}),
    ("=0 ok", {"kind": "reply", "seq": 0, "fields": {}}),
    ("=65535 ok st=fault f=6 pos=-2147483648",
     {"kind": "reply", "seq": 65535, "fields": {"st": "fault", "f": "6", "pos": "-2147483648"}}),
    ("=17 err 8", {"kind": "refusal", "seq": 17, "code": 8}),
    ("=0 err 1", {"kind": "refusal", "seq": 0, "code": 1}),
    ("=3 err 14", {"kind": "refusal", "seq": 3, "code": 14}),
    ("=? err 2", {"kind": "nak", "code": 2}),
    ("=? err 10", {"kind": "nak", "code": 10}),
    ("!42 SHOT id=150 pos=1200 trg=300",
     {"kind": "event", "number": 42, "name": "SHOT", "fields": {"id": "150", "pos": "1200", "trg": "300"}}),
    ("!1 BOOT why=2 boot=17", {"kind": "event", "number": 1, "name": "BOOT", "fields": {"why": "2", "boot": "17"}}),
    ("!3 TESTED seq=9", {"kind": "event", "number": 3, "name": "TESTED", "fields": {"seq": "9"}}),
    ("!7 HOMED seq=4 was=-461",
     {"kind": "event", "number": 7, "name": "HOMED", "fields": {"seq": "4", "was": "-461"}}),
    ("=2 ok las=2", {"kind": "reply", "seq": 2, "fields": {"las": "2"}}),
]  # fmt: skip

DAMAGED = ["", "=17 ok*0000", "=17 ok", "=17 ok*f4bb", "=17 ok*F4B", "=? ok*", sealed("@17 STAT"), sealed("hello")]


def vectors():
    """All of it, as it is written."""
    texts = [text for text, _ in PARSE] + ["123456789", "@17 SHOT to=1200 id=150", "@1 HELLO ses=5", "STAT"]
    return {
        "about": "Lines of JXS/1 (PROTOCOL.md), byte for byte; each character is a byte (latin-1). "
        "lines: a text with its CRC. encode: a command as its line. parse: a line as its message. "
        "dialogues: from a fresh boot, what is sent and what comes back; `machine` is what happens meanwhile.",
        "lines": [{"text": text, "line": sealed(text)} for text in texts],
        "encode": [
            {"seq": seq, "verb": verb, "args": args,
             "line": sealed(" ".join([f"@{seq} {verb}", *(f"{key}={value}" for key, value in args.items())]))}
            for seq, verb, args in ENCODE
        ],
        "parse": [{"line": sealed(text), "message": message} for text, message in PARSE]
        + [{"line": line, "message": {"kind": "damaged"}} for line in DAMAGED if line],
        "dialogues": [{"name": name, "steps": steps} for name, steps in DIALOGUES.items()],
    }  # fmt: skip


if __name__ == "__main__":
    OUT.write_text(json.dumps(vectors(), indent=1, ensure_ascii=True) + "\n")
