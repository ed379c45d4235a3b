"""Dialogues about two lasers. With one, or an earlier firmware, nothing of this is said."""

from dialogue import NAK, machine, raw, ready, sealed, status, step


DIALOGUES = {
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
