"""Steps of a dialogue: lines sent, lines received, and events in between."""

import binascii


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
