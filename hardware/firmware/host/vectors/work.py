"""Dialogues about work: motions, shots, faults, and a person at the terminal."""

from dialogue import FORGED, HELLO, NAK, SEQ_7, WELCOME, machine, raw, ready, status, step


DIALOGUES = {
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
