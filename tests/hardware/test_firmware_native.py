"""The firmware's portable half, built for this machine with sanitizers: its lines byte for byte, and its invariants."""

import binascii
import os
import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from .golden import ENCODED, dialogues, sealed


ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "hardware" / "firmware"
DIALOGUES = dialogues()
MISSING = [tool for tool in ("gcc", "make") if not shutil.which(tool)]

pytestmark = [
    pytest.mark.rig,
    pytest.mark.skipif(
        bool(MISSING) and not os.environ.get("JAXSCAN_REQUIRE_BENCH"),
        reason=f"the firmware's native build needs {', '.join(MISSING)}: type `make bench-deps`",
    ),
]

LONGEST_ANSWER = 127
READY = ("HELLO ses=5", "EN on=1", "HOME max=9", "\0end", "ARM on=1")


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A build of its own: several processes may run these tests at once."""
    folder = tmp_path_factory.mktemp("firmware")
    done = subprocess.run(
        ["make", "-s", "-C", str(FIRMWARE), "host", f"BUILD={folder}"], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def talk(build):
    """Runs steps from a fresh boot; returns the answers to each. A step that begins with NUL is for the machine."""

    def run(steps):
        spoken = b"".join(step + b"\0mark\n" for step in (b"\0boot\n", *steps))
        done = subprocess.run([build / "talk"], input=spoken, capture_output=True, timeout=60)
        assert done.returncode == 0, done.stderr.decode()
        answers = done.stdout.split(b"\0\n")
        assert answers.pop() == b""
        assert len(answers) == len(steps) + 1
        return answers[1:]

    return run


def commands(*texts, seq=1):
    """The texts as numbered lines; those that begin with NUL stay orders to the machine."""
    lines = []
    for text in texts:
        if text.startswith("\0"):
            lines.append(text.encode() + b"\n")
        else:
            lines.append(sealed(f"@{seq} {text}"))
            seq += 1
    return lines


def fields(answer):
    """A good answer's fields, its CRC checked."""
    body, _, crc = answer.rstrip(b"\n").rpartition(b"*")
    assert b"%04X" % binascii.crc_hqx(body, 0xFFFF) == crc, answer
    head, _, words = body.decode().partition(" ok")
    assert head.startswith("=") and " err" not in head, answer
    return dict(word.split("=") for word in words.split())


@pytest.mark.parametrize("name", DIALOGUES)
def test_answers_byte_for_byte(talk, name):
    steps = DIALOGUES[name]
    for step, answer in zip(steps, talk([step.sent for step in steps]), strict=True):
        assert answer == step.answer, step


def test_every_encoded_command_is_understood(talk):
    """None is refused for its form (1), verb (3) or arguments (4)."""
    for (*command, _), answer in zip(ENCODED, talk([line for *_, line in ENCODED]), strict=True):
        assert not re.search(rb" err (1|2|3|4|10)\*", answer), (command, answer)


def test_the_longest_answers_fit(talk):
    """Every setting, counter and position at its longest text, with the longest sequence number."""
    longest = [
        "SET wd=60000 vmax=10000 vst=10000 acc=60000 hv=10000 back=10000 dir=1",
        "SET settl=10000 lon=10000 loff=10000 exp=5000 gap=10000 rdy=10000",
        "SET smin=-2147483648 smax=-2147483648",
    ]
    asked = ["CFG", "CFG shot=1", "STAT", "CNT", "HELLO ses=2147483647"]
    steps = commands(*longest) + [b"\0extreme\n", b"\0fault 6\n", b"\0extreme\n"]
    steps += [sealed(f"@65535 {text}") if text.startswith("HELLO") else sealed(f"@{65500 + k} {text}") for k, text in
              enumerate(asked)]  # fmt: skip
    answers = talk(steps)
    assert all(answer.startswith(b"=") and b" ok*" in answer for answer in answers[:3]), answers[:3]
    *config, status, counters, hello = (fields(answer) for answer in answers[-5:])
    motion = "wd=60000 vmax=10000 vst=10000 acc=60000 hv=10000 back=10000 dir=1"
    assert config[0] == dict(word.split("=") for word in motion.split())
    assert config[1]["smin"] == config[1]["smax"] == "-2147483648" and config[1]["exp"] == "5000"
    assert status["pos"] == "-2147483648" and status["st"] == "fault" and status["le"] == "65535"
    assert counters["las"] == counters["up"] == "4294967295" and counters["was"] == "-2147483648"
    assert hello["buf"] == "96"
    lengths = [len(line) for answer in answers for line in answer.split(b"\n")]
    assert 100 < max(lengths) <= LONGEST_ANSWER


@pytest.mark.parametrize(
    "setting",
    ["vmax=0", "acc=0", "vst=0", "hv=0", "exp=0", "vmax=49", "vmax=10001", "vst=4001", "wd=99", "wd=60001", "acc=99",
     "acc=60001", "back=-1", "back=10001", "dir=2", "settl=10001", "lon=-1", "loff=10001", "exp=5001", "gap=10001",
     "rdy=10001", "smin=1 smax=0", "vmax=399"],
)  # fmt: skip
def test_settings_change_all_or_none(talk, setting):
    """One bad value, with good ones before and after it."""
    before = talk(commands("CFG", "CFG shot=1"))
    first, *last = (word for word in ("hv=777", "gap=77") if word.split("=")[0] not in setting)
    refused, *after = talk([*commands(" ".join(["SET", first, setting, *last]), seq=9), *commands("CFG", "CFG shot=1")])
    assert refused == sealed("=9 err 4")
    assert after == before
    accepted, *after = talk([*commands("SET hv=777 gap=77", seq=9), *commands("CFG", "CFG shot=1")])
    assert accepted == sealed("=9 ok")
    assert fields(after[0])["hv"] == "777" and fields(after[1])["gap"] == "77"


def test_forged_and_damaged_laser_lines_light_nothing(talk):
    """Fifty lines that ask for light, each with something wrong, in a session that is armed."""
    rng = random.Random(20)
    good = sealed("@77 LASER on=1 ms=1000")
    forged = [b"@%d LASER on=1 ms=1000*%04X\n" % (k, crc) for k in range(100, 120) for crc in [rng.randrange(65536)]
              if crc != binascii.crc_hqx(b"@%d LASER on=1 ms=1000" % k, 0xFFFF)]  # fmt: skip
    damaged = []
    while len(damaged) < 30:
        where, bit = rng.randrange(len(good) - 1), 1 << rng.randrange(8)
        line = bytearray(good)
        line[where] ^= bit
        if rng.random() < 0.3:
            del line[where]
        if 0x1B not in line and b"\n" not in line[:-1] and bytes(line) != good:
            damaged.append(bytes(line))
    steps = commands(*READY)
    answers = talk([*steps, *forged, *damaged, *commands("STAT", "CNT", seq=200), good, *commands("CNT", seq=300)])
    status, counters, lit, after = answers[-4:]
    assert fields(status)["las"] == "0" and fields(status)["arm"] == "1"
    assert fields(counters)["las"] == "0"
    assert lit == sealed("=77 ok")
    assert fields(after)["las"] == "1", "the line that was damaged above would have lit it"


needs_avr = pytest.mark.skipif(
    not shutil.which("avr-gcc") and not os.environ.get("JAXSCAN_REQUIRE_BENCH"),
    reason="the firmware itself needs gcc-avr and avr-libc: type `make bench-deps`",
)


@needs_avr
def test_the_firmware_leaves_room(tmp_path):
    """`make size` refuses more than 60 % of flash or memory: the rest of the memory is the stack."""
    done = subprocess.run(
        ["make", "-s", "-C", str(FIRMWARE), "size", f"BUILD={tmp_path}"], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    flash, memory = (float(percent) for percent in re.findall(r"\(([0-9.]+) %\)", done.stdout))
    assert 10 < flash <= 60 and 10 < memory <= 60


@needs_avr
def test_what_a_halt_reads_of_the_ramp_is_never_half_written(tmp_path):
    """A halt may interrupt the step's own interrupt: every store to `interval`, of four bytes, has interrupts off."""
    image = tmp_path / "scan.elf"
    subprocess.run(["make", "-s", "-C", str(FIRMWARE), str(image), f"BUILD={tmp_path}"], check=True, timeout=120)
    symbols = subprocess.run(["avr-nm", image], capture_output=True, text=True, check=True, timeout=60).stdout
    start = int(re.search(r"^0080([0-9a-f]{4}) \w interval$", symbols, re.MULTILINE)[1], 16)
    code = subprocess.run(["avr-objdump", "-d", image], capture_output=True, text=True, check=True, timeout=60).stdout
    stored, off = [], False
    for line in code.splitlines():
        # Straight through each function: from `cli` to `sei`, to the flags put back, or to the function's end.
        if line.endswith(">:") or re.search(r"\tsei|\tout\t0x3f|\treti?\b", line):
            off = False
        elif "\tcli" in line:
            off = True
        elif (store := re.search(r"\tsts\t0x([0-9A-F]{4})", line)) and start <= int(store[1], 16) < start + 4:
            stored.append(int(store[1], 16) - start)
            assert off, line
    assert sorted(set(stored)) == [0, 1, 2, 3]


def test_the_brown_out_fuse_fits_the_clock():
    """With the fuses of the guide the ATmega328P is reset before its clock is too fast for its voltage."""
    clock_hz = int(re.search(r"-DF_CPU=(\d+)", (FIRMWARE / "Makefile").read_text())[1])
    needed_v = 2.7 + (clock_hz - 10e6) / (20e6 - 10e6) * (4.5 - 2.7)
    guide = (FIRMWARE / "README.md").read_text()
    level = {0b110: 1.8, 0b101: 2.7, 0b100: 4.3}[int(re.search(r"efuse:w:0x([0-9A-F]{2})", guide)[1], 16) & 0b111]
    assert level > needed_v
    assert f"brown-out at {level} V" in guide and f"it needs {needed_v:.1f} V" in guide


def fuzz(build, lines, seed):
    done = subprocess.run([build / "fuzz", str(lines), str(seed)], capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("seed", [1, 2])
def test_fuzzed_lines(build, seed):
    assert "10000 lines" in fuzz(build, 10000, seed)


@pytest.mark.slow
def test_a_million_fuzzed_lines(build):
    assert "1000000 lines" in fuzz(build, 1000000, 7)
