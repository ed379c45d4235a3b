"""Writes hardware/protocol_vectors.json: lines that both sides must send, with independently computed CRCs.

    python hardware/firmware/host/vectors.py

The answers below are written by hand from PROTOCOL.md. None is what the firmware happened to say.
"""

import binascii
import json
from pathlib import Path


STAT = "st=idle f=0 pos=0 hm=0 arm=0 en=0 las=0 le=0 trg=0 in=0"
MOTION = "wd=500 vmax=4000 vst=400 acc=8000 hv=200 back=0 dir=0"
SHOTS = "settl=50 lon=20 loff=20 exp=10 gap=5 rdy=0 smin=-2147483648 smax=2147483647"
WELCOME = "proto=1 fw=1.0.0 boot=17 lease=1000 buf=96"
HELLO = ("@1 HELLO ses=5", f"=1 ok {WELCOME}")


def sealed(text):
    return f"{text}*{binascii.crc_hqx(text.encode('latin-1'), 0xFFFF):04X}"


def step(sent, *answers, machine=False, raw=False):
    """One line and its answers. raw: `sent` is sent unchanged; machine: an order to the fake machine."""
    answer = "".join(sealed(text) + "\n" for text in answers)
    if machine:
        return {"machine": sent, "answer": answer}
    return {"sent": sent if raw else sealed(sent) + "\n", "answer": answer}


def raw(sent, *answers):
    return step(sent, *answers, raw=True)


def machine(order, *answers):
    return step(order, *answers, machine=True)


def ready(*more):
    """A session, homed, enabled and armed; the next sequence number is 5, one event was sent."""
    return [
        step(*HELLO),
        step("@2 EN on=1", "=2 ok"),
        step("@3 HOME max=30000", "=3 ok"),
        machine("end", "!1 HOMED seq=3 was=0"),
        step("@4 ARM on=1", "=4 ok"),
        *more,
    ]


def status(seq, event, **changed):
    words = dict(word.split("=") for word in STAT.split()) | {key: str(value) for key, value in changed.items()}
    return f"={seq} ok " + " ".join(f"{key}={value}" for key, value in words.items()) + f" ev={event}"


NAK, LONG = "=? err 2", "=? err 10"
SEQ_7 = sealed("@7 STAT")
FORGED = f"@8 LASER on=1 ms=1000*{binascii.crc_hqx(b'@8 LASER on=1 ms=1000', 0xFFFF) ^ 0x0100:04X}\n"


LINE_DIALOGUES = {
    "a fresh boot says where it stands": [step("@1 STAT", status(1, 1)), step("@2 CFG", f"=2 ok {MOTION}")],
    "settings of shots": [step("@1 CFG shot=1", f"=1 ok {SHOTS}"), step("@2 CFG shot=0", f"=2 ok {MOTION}")],
    "shot=2 is no part of the settings": [step("@1 CFG shot=2", "=1 err 4")],
    "counters": [step("@1 CNT", "=1 ok crc=0 over=0 dup=0 las=0 up=0 wdr=0 was=0")],
    "hello": [step(*HELLO), step("@2 STAT", status(2, 0))],
    "hello wants a session of 1 and more": [
        step("@1 HELLO ses=0", "=1 err 4"),
        step("@2 HELLO ses=-1", "=2 err 4"),
        step("@3 HELLO", "=3 err 4"),
        step("@4 HELLO ses=2147483647", f"=4 ok {WELCOME}"),
    ],
    "hello twice is carried out twice": [step(*HELLO), step(*HELLO), step("@2 PING", "=2 ok")],
    "no session, no motion, no light": [
        step("@1 MOVE to=5", "=1 err 9"),
        step("@2 HOME max=5", "=2 err 9"),
        step("@3 SHOT to=5 id=1", "=3 err 9"),
        step("@4 TRIG", "=4 err 9"),
        step("@5 ARM on=1", "=5 err 9"),
        step("@6 LASER on=1 ms=5", "=6 err 9"),
        step("@7 SELFTEST", "=7 err 9"),
        step("@8 LASER on=0", "=8 ok"),
        step("@9 ARM on=0", "=9 ok"),
        step("@10 STOP", "=10 ok"),
        step("@11 EN on=1", "=11 ok"),
    ],
    "a damaged CRC": [raw("@1 STAT*0000\n", NAK), step("@2 CNT", "=2 ok crc=1 over=0 dup=0 las=0 up=0 wdr=0 was=0")],
    "a lower-case CRC is none": [raw(f"@7 STAT*{SEQ_7[-4:].lower()}\n", NAK)],
    "a short CRC": [raw(SEQ_7[:-1] + "\n", NAK)],
    "something after the CRC": [raw(SEQ_7 + " \n", NAK)],
    "a carriage return before the newline": [raw(SEQ_7 + "\r\n", status(7, 1))],
    "no CRC in a strict session": [step(*HELLO), raw("STAT\n", NAK), raw("@2 STAT\n", NAK), raw("LASER on=0\n", NAK)],
    "a sequence number needs a CRC, always": [raw("@1 STAT\n", NAK), raw("@1 HELLO ses=5\n", NAK)],
    "a lost star changes no number": [*ready(raw("@5 MOVE to=1200" + sealed("@5 MOVE to=1200")[-4:] + "\n", NAK))],
    "a line of its own begins with a newline": [raw("@9 STA\n" + SEQ_7 + "\n", NAK, status(7, 1))],
    "empty lines are no lines": [raw("\n\r\n\n" + SEQ_7 + "\n", status(7, 1))],
    "an unknown verb": [step("@1 JUMP", "=1 err 3"), step("@2 STATUS", "=2 err 3"), step("@3 STA", "=3 err 3")],
    "a lower-case verb": [step("@1 stat", "=1 err 1"), step("@2 Stat", "=2 err 1")],
    "an unknown key": [*ready(step("@5 MOVE to=5 by=3", "=5 err 4"), step("@6 STAT x=1", "=6 err 4"))],
    "a key twice": [*ready(step("@5 MOVE to=5 to=5", "=5 err 4"))],
    "a key of another verb": [*ready(step("@5 MOVE max=5", "=5 err 4"), step("@6 HOME to=5", "=6 err 4"))],
    "a key is missing": [*ready(step("@5 MOVE", "=5 err 4"), step("@6 SHOT to=5", "=6 err 4"))],
    "integers of 32 bits": [
        *ready(
            step("@5 MOVE to=2147483648", "=5 err 4"),
            step("@6 MOVE to=-2147483649", "=6 err 4"),
            step("@7 MOVE to=99999999999999999999", "=7 err 4"),
            step("@8 MOVE to=4294967297", "=8 err 4"),
            step("@9 MOVE to=2147483647", "=9 ok"),
            machine("end", "!2 DONE seq=9 pos=2147483647"),
            step("@10 MOVE to=-2147483648", "=10 ok"),
            machine("end", "!3 DONE seq=10 pos=-2147483648"),
        )
    ],
    "each number has one spelling": [
        *ready(
            step("@5 MOVE to=007", "=5 err 1"),
            step("@6 MOVE to=+7", "=6 err 1"),
            step("@7 MOVE to=-0", "=7 err 1"),
            step("@8 MOVE to=0x10", "=8 err 1"),
            step("@9 MOVE to=", "=9 err 1"),
            step("@10 MOVE to=-", "=10 err 1"),
            step("@11 MOVE to=1.5", "=11 err 1"),
            step("@12 MOVE to=0", "=12 ok"),
        )
    ],
    "spaces": [
        step("@1  STAT", "=1 err 1"),
        step("@2 STAT ", "=2 err 1"),
        step("@3 CFG  shot=1", "=3 err 1"),
        step("@4 CFG shot =1", "=4 err 1"),
        step("@5 ", "=5 err 1"),
        step("@6 CFG\tshot=1", "=6 err 1"),
    ],
    "a star within": [raw(f"{sealed('@1 STAT*X')}\n", NAK)],
    "sequence numbers": [
        step("@0 STAT", "=0 err 1"),
        step("@07 STAT", "=0 err 1"),
        step("@65536 STAT", "=0 err 1"),
        step("@-1 STAT", "=0 err 1"),
        step("@ STAT", "=0 err 1"),
        step("@STAT", "=0 err 1"),
        step("@7", "=0 err 1"),
        step("@65535 PING", "=65535 ok"),
        step("@1 PING", "=1 ok"),
        step("PING", "=0 ok"),
    ],
    "a repeated number repeats the answer and does nothing": [
        *ready(
            step("@5 MOVE to=100", "=5 ok"),
            step("@5 MOVE to=100", "=5 ok"),
            machine("end", "!2 DONE seq=5 pos=100"),
            step("@5 MOVE to=100", "=5 ok"),
            step("@6 STAT", status(6, 2, pos=100, hm=1, arm=1, en=1)),
            step("@6 STAT", status(6, 2, pos=100, hm=1, arm=1, en=1)),
            step("@7 CNT", "=7 ok crc=0 over=0 dup=3 las=0 up=0 wdr=0 was=0"),
        )
    ],
    "a repeated refusal stays one": [
        step(*HELLO),
        step("@2 MOVE to=5", "=2 err 11"),
        step("@2 MOVE to=5", "=2 err 11"),
    ],
    "a damaged line between does not disturb the repetition": [
        step(*HELLO),
        step("@2 EN on=1", "=2 ok"),
        raw("@3 XXX*0000\n", NAK),
        step("@2 EN on=1", "=2 ok"),
        step("@3 CNT", "=3 ok crc=1 over=0 dup=1 las=0 up=0 wdr=0 was=0"),
    ],
    "96 bytes are a line, 97 are none": [
        raw("@5 STAT" + "x" * 89 + "\n", NAK),
        raw("@5 STAT" + "x" * 90 + "\n", LONG),
        raw("@" * 300 + "\n", LONG),
        step("@6 PING", "=6 ok"),
    ],
    "the longest line that does something": [
        step("@1 SET vmax=1000 vst=20 acc=100 hv=20 back=0 dir=0 settl=0 lon=0 loff=0 exp=1 gap=0 rdy=10", "=1 ok"),
        step("@2 CFG shot=1", "=2 ok settl=0 lon=0 loff=0 exp=1 gap=0 rdy=10 smin=-2147483648 smax=2147483647"),
    ],
    "settings all or none": [
        step("@1 SET vmax=0", "=1 err 4"),
        step("@2 SET hv=300 acc=0", "=2 err 4"),
        step("@3 SET hv=300 exp=0", "=3 err 4"),
        step("@4 SET hv=300 nonsense=1", "=4 err 4"),
        step("@5 SET", "=5 err 4"),
        step("@6 SET vmax=300", "=6 err 4"),
        step("@7 SET vmax=300 vst=300", "=7 ok"),
        step("@8 SET smin=10 smax=9", "=8 err 4"),
        step("@9 SET wd=99", "=9 err 4"),
        step("@10 SET wd=60001", "=10 err 4"),
        step("@11 SET hv=10001", "=11 err 4"),
        step("@12 SET dir=2", "=12 err 4"),
        step("@13 CFG", f"=13 ok {MOTION.replace('4000', '300').replace('vst=400', 'vst=300')}"),
    ],
}  # fmt: skip


WORK_DIALOGUES = {
    "disabled, not homed, not armed": [
        step(*HELLO),
        step("@2 MOVE to=5", "=2 err 11"),
        step("@3 HOME max=5", "=3 err 11"),
        step("@4 EN on=1", "=4 ok"),
        step("@5 SHOT to=5 id=1", "=5 err 8"),
        step("@6 HOME max=5", "=6 ok"),
        machine("end", "!1 HOMED seq=6 was=0"),
        step("@7 SHOT to=5 id=1", "=7 err 14"),
        step("@8 LASER on=1 ms=5", "=8 err 14"),
        step("@9 SHOT to=5 id=1 m=2", "=9 ok"),
        machine("end", "!2 SHOT id=1 pos=5 trg=1"),
    ],
    "home": [
        step(*HELLO),
        step("@2 EN on=1", "=2 ok"),
        machine("pos 37"),
        step("@3 HOME max=0", "=3 err 4"),
        step("@4 HOME max=-5", "=4 err 4"),
        step("@5 HOME max=30000", "=5 ok"),
        step("@6 STAT", status(6, 0, st="home", pos=37, en=1)),
        machine("end", "!1 HOMED seq=5 was=37"),
        step("@7 CNT", "=7 ok crc=0 over=0 dup=0 las=0 up=0 wdr=0 was=37"),
        step("@8 EN on=0", "=8 ok"),
        step("@9 STAT", status(9, 1)),
    ],
    "a shot": [
        *ready(
            step("@5 SHOT to=1200 id=150", "=5 ok"),
            step("@6 STAT", status(6, 1, st="shot", hm=1, arm=1, en=1)),
            step("@7 SHOT to=1200 id=151", "=7 err 5"),
            step("@8 SET exp=5", "=8 err 5"),
            step("@9 LASER on=1 ms=5", "=9 err 5"),
            machine("end", "!2 SHOT id=150 pos=1200 trg=2"),
            step("@10 SHOT to=1200 id=2147483647 m=1", "=10 ok"),
            machine("end", "!3 SHOT id=2147483647 pos=1200 trg=3"),
            step("@11 SHOT to=1200 id=1 m=0", "=11 err 4"),
            step("@12 SHOT to=1200 id=1 m=4", "=12 err 4"),
            step("@13 SHOT to=1200 id=-1", "=13 err 4"),
        )
    ],
    "soft limits": [
        *ready(
            step("@5 SET smin=-10 smax=100", "=5 ok"),
            step("@6 MOVE to=101", "=6 err 13"),
            step("@7 MOVE to=-11", "=7 err 13"),
            step("@8 SHOT to=101 id=1", "=8 err 13"),
            step("@9 MOVE to=100", "=9 ok"),
            machine("end", "!2 DONE seq=9 pos=100"),
            step("@10 SET back=10", "=10 ok"),
            step("@11 EN on=0", "=11 ok"),
            step("@12 EN on=1", "=12 ok"),
            step("@13 MOVE to=-2147483640", "=13 err 13"),
        )
    ],
    "laser": [
        *ready(
            step("@5 LASER on=1", "=5 err 4"),
            step("@6 LASER on=1 ms=0", "=6 err 4"),
            step("@7 LASER on=1 ms=1001", "=7 err 4"),
            step("@8 LASER on=2 ms=5", "=8 err 4"),
            raw(FORGED, NAK),
            step("@9 LASER on=1 ms=1000", "=9 ok"),
            step("@10 STAT", status(10, 1, hm=1, arm=1, en=1, las=1, le=1000)),
            step("@11 LASER on=0", "=11 ok"),
            step("@12 STAT", status(12, 1, hm=1, arm=1, en=1)),
            step("@13 SELFTEST", "=13 err 5"),
            step("@14 ARM on=0", "=14 ok"),
            step("@15 SELFTEST", "=15 ok"),
            machine("end", "!2 TESTED seq=15"),
        )
    ],
    "laser off ends a shot": [
        *ready(
            step("@5 SHOT to=9 id=1", "=5 ok"),
            step("@6 LASER on=0", "=6 ok"),
            machine("end", "!2 DONE seq=5 pos=0"),
        )
    ],
    "the contactor opens at rest where nobody is there, without a fault": [
        *ready(
            machine("pass 9999"),
            step("@5 STAT", status(5, 1, hm=1, arm=1, en=1)),
            machine("pass 9999"),
            raw("@6 STAT*0000\n", NAK),
            machine("pass 1"),
            step("@6 STAT", status(6, 1, hm=1, en=1)),
            step("@7 SHOT to=9 id=1", "=7 err 14"),
            step("@8 ARM on=1", "=8 ok"),
            step("@9 SHOT to=9 id=1", "=9 ok"),
        )
    ],
    "who allows a longer silence has the contactor closed as long": [
        *ready(
            step("@5 SET wd=60000", "=5 ok"),
            machine("pass 59999"),
            step("@6 STAT", status(6, 1, hm=1, arm=1, en=1)),
            machine("pass 60000"),
            step("@7 STAT", status(7, 1, hm=1, en=1)),
        )
    ],
    "hello opens the contactor": [
        *ready(step(*HELLO), step("@2 STAT", status(2, 0, hm=1, en=1)), step("@3 LASER on=1 ms=5", "=3 err 14"))
    ],
    "stop": [
        *ready(
            step("@5 STOP", "=5 ok"),
            step("@6 MOVE to=900", "=6 ok"),
            step("@7 STOP", "=7 ok"),
            machine("end", "!2 DONE seq=6 pos=0"),
        )
    ],
    "one exposure": [
        step(*HELLO),
        step("@2 TRIG ms=0", "=2 err 4"),
        step("@3 TRIG ms=5001", "=3 err 4"),
        step("@4 TRIG", "=4 ok"),
        step("@5 TRIG", "=5 err 5"),
        machine("end"),
        step("@6 STAT", status(6, 0, trg=1)),
    ],
    "a fault refuses until it is cleared": [
        *ready(
            machine("fault 2", "!2 FAULT f=2 pos=0"),
            step("@5 MOVE to=5", "=5 err 6"),
            step("@6 EN on=1", "=6 err 6"),
            step("@7 ARM on=1", "=7 err 6"),
            step("@8 LASER on=1 ms=5", "=8 err 6"),
            step("@9 TRIG", "=9 err 6"),
            step("@10 SELFTEST", "=10 err 6"),
            step("@11 LASER on=0", "=11 ok"),
            step("@12 SET exp=5", "=12 ok"),
            step("@13 STAT", status(13, 2, st="fault", f=2, hm=1, en=1)),
            step("@14 CLEAR", "=14 ok"),
            step("@15 LASER on=1 ms=5", "=15 err 14"),
        )
    ],
    "the e-stop holds as long as it is pressed": [
        *ready(
            machine("input 2"),
            machine("fault 1", "!2 FAULT f=1 pos=0"),
            step("@5 CLEAR", "=5 err 6"),
            step("@6 STAT", status(6, 2, st="fault", f=1, **{"in": 2})),
            machine("input 0"),
            step("@7 CLEAR", "=7 ok"),
            step("@8 MOVE to=1", "=8 err 11"),
        )
    ],
    "esc aborts, wherever in a line": [
        *ready(
            step("@5 MOVE to=900", "=5 ok"),
            raw("@6 STA\x1b" + SEQ_7 + "\n", "!2 FAULT f=5 pos=0", status(7, 2, st="fault", f=5, hm=1, en=1)),
        )
    ],
    "esc ends a line that was too long": [raw("x" * 200 + "\x1b" + SEQ_7 + "\n", "!2 FAULT f=5 pos=0",
                                              status(7, 2, st="fault", f=5))],
    "a person": [
        raw("?", status(0, 1)),
        raw("\n", ),
        raw("STAT\n", status(0, 1)),
        raw("?STAT\n", status(0, 1), status(0, 1)),
        raw("MOVE to=5\r\n", "=0 err 9"),
        raw("HELLO ses=1\n", f"=0 ok {WELCOME}"),
        raw("stat\n", "=0 err 1"),
        raw("ARM on=1\n", "=0 ok"),
        raw("LASER on=1 ms=500\n", "=0 ok"),
        raw("LASER on=0\n", "=0 ok"),
        raw("LASER on=0*0000\n", NAK),
        step("LASER on=0", "=0 ok"),
        step("@7 STAT", status(7, 0, arm=1)),
    ],
    "a person takes over, a program takes back": [
        step(*HELLO),
        raw("STAT\n", NAK),
        raw("HELLO ses=0\n", "=0 err 4"),
        raw("STAT\n", NAK),
        raw("HELLO ses=1\n", f"=0 ok {WELCOME}"),
        raw("STAT\n", status(0, 0)),
        step(*HELLO),
        raw("STAT\n", NAK),
        raw("?", status(0, 0)),
    ],
    "bytes that are no letters": [raw("\x00\x01\xff\xfe\n"[1:], "=0 err 1"), step("@1 ST\x7fAT", "=1 err 1")],
}  # fmt: skip


LASER_DIALOGUES = {
    "how many lasers there are": [step("@1 HAS", "=1 ok las=2"), step("@2 HAS las=1", "=2 err 4")],
    "the laser that is not named is the first": [
        *ready(
            step("@5 LASER on=1 ms=500", "=5 ok"),
            step("@6 STAT", status(6, 1, hm=1, arm=1, en=1, las=1, le=500)),
            step("@7 LASER on=1 ms=400 n=1", "=7 ok"),
            step("@8 STAT", status(8, 1, hm=1, arm=1, en=1, las=1, le=400)),
            step("@9 CNT", "=9 ok crc=0 over=0 dup=0 las=1 up=0 wdr=0 was=0"),
        )
    ],
    "the second laser": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            step("@6 STAT", status(6, 1, hm=1, arm=1, en=1, las=2, le=1000)),
            step("@7 LASER on=0", "=7 ok"),
            step("@8 STAT", status(8, 1, hm=1, arm=1, en=1)),
        )
    ],
    "one laser at a time": [
        *ready(
            step("@5 LASER on=1 ms=1000", "=5 ok"),
            step("@6 LASER on=1 ms=300 n=2", "=6 ok"),
            step("@7 STAT", status(7, 1, hm=1, arm=1, en=1, las=2, le=300)),
            step("@8 LASER on=1 ms=200 n=1", "=8 ok"),
            step("@9 STAT", status(9, 1, hm=1, arm=1, en=1, las=1, le=200)),
            step("@10 CNT", "=10 ok crc=0 over=0 dup=0 las=3 up=0 wdr=0 was=0"),
        )
    ],
    "off is off for all lasers, whatever is named": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            step("@6 LASER on=0 n=1", "=6 ok"),
            step("@7 STAT", status(7, 1, hm=1, arm=1, en=1)),
            step("@8 LASER on=0 n=9", "=8 ok"),
        )
    ],
    "a laser that is not there": [
        *ready(
            step("@5 LASER on=1 ms=500 n=3", "=5 err 4"),
            step("@6 LASER on=1 ms=500 n=0", "=6 err 4"),
            step("@7 LASER on=1 ms=500 n=-1", "=7 err 4"),
            step("@8 LASER on=1 n=2", "=8 err 4"),
            step("@9 SHOT to=9 id=1 n=3", "=9 err 4"),
            step("@10 SHOT to=9 id=1 m=2 n=0", "=10 err 4"),
            step("@11 LASER on=1 ms=500 n=2 n=2", "=11 err 4"),
            step("@12 MOVE to=9 n=2", "=12 err 4"),
            step("@13 CNT", "=13 ok crc=0 over=0 dup=0 las=0 up=0 wdr=0 was=0"),
        )
    ],
    "a forged line does not light the second laser": [
        *ready(raw(f"@5 LASER on=1 ms=500 n=2*{sealed('@5 LASER on=1 ms=500 n=1')[-4:]}\n", NAK),
               step("@6 CNT", "=6 ok crc=1 over=0 dup=0 las=0 up=0 wdr=0 was=0"))
    ],
    "the second laser needs the contactor": [
        *ready(
            step("@5 ARM on=0", "=5 ok"),
            step("@6 LASER on=1 ms=500 n=2", "=6 err 14"),
            step("@7 SHOT to=9 id=1 n=2", "=7 err 14"),
        )
    ],
    "arm on=0 puts the second laser off": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            step("@6 ARM on=0", "=6 ok"),
            step("@7 STAT", status(7, 1, hm=1, en=1)),
        )
    ],
    "shots of both lasers in turn": [
        *ready(
            step("@5 SHOT to=80 id=20 n=1", "=5 ok"),
            machine("end", "!2 SHOT id=20 pos=80 trg=2"),
            step("@6 SHOT to=80 id=21 n=2", "=6 ok"),
            step("@7 LASER on=1 ms=5 n=1", "=7 err 5"),
            machine("end", "!3 SHOT id=21 pos=80 trg=4"),
            step("@8 SHOT to=80 id=22 m=1 n=2", "=8 ok"),
            machine("end", "!4 SHOT id=22 pos=80 trg=5"),
            step("@9 CNT", "=9 ok crc=0 over=0 dup=0 las=3 up=0 wdr=0 was=0"),
        )
    ],
    "the lease of the second laser runs out": [
        *ready(
            step("@5 LASER on=1 ms=400 n=2", "=5 ok"),
            machine("pass 399"),
            step("@6 STAT", status(6, 1, hm=1, arm=1, en=1, las=2, le=1)),
            machine("pass 1", "!2 FAULT f=3 pos=0"),
            step("@7 STAT", status(7, 2, st="fault", f=3, hm=1, en=1)),
        )
    ],
    "the link watchdog puts the second laser off": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            machine("pass 500", "!2 FAULT f=2 pos=0"),
            step("@6 STAT", status(6, 2, st="fault", f=2, hm=1, en=1)),
        )
    ],
    "esc puts the second laser off": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            raw("\x1b" + sealed("@6 STAT") + "\n", "!2 FAULT f=5 pos=0", status(6, 2, st="fault", f=5, hm=1, en=1)),
        )
    ],
    "hello puts the second laser off": [
        *ready(
            step("@5 LASER on=1 ms=1000 n=2", "=5 ok"),
            step("@6 HELLO ses=6", "=6 ok proto=1 fw=1.0.0 boot=17 lease=1000 buf=96"),
            step("@7 STAT", status(7, 0, hm=1, en=1)),
        )
    ],
}  # fmt: skip


OUT = Path(__file__).resolve().parents[2] / "protocol_vectors.json"

DIALOGUES = {**LINE_DIALOGUES, **WORK_DIALOGUES, **LASER_DIALOGUES}

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
