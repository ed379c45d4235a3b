"""The protocol on the host's side: lines encoded, lines accepted, and lines rejected."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scanrig.controllers.jxs.protocol import (
    ABORT,
    LONGEST_COMMAND,
    Damaged,
    Event,
    LineReader,
    Nak,
    Refusal,
    Reply,
    crc,
    decode,
    encode,
    seal,
)

from .golden import ENCODED, dialogues


BUSY = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""A computer with other things to do takes its time over examples."""

SEQUENCES = st.integers(0, 65535)
KEYS = st.text("abcdefghijklmnopqrstuvwxyz", min_size=1, max_size=5)
VALUES = st.one_of(st.integers(-(2**31), 2**31 - 1).map(str), st.text("abcdxyz.019", min_size=1, max_size=6))
FIELDS = st.dictionaries(KEYS, VALUES, max_size=5)
NAMES = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ", min_size=1, max_size=8)


def written(fields):
    return "".join(f" {key}={value}" for key, value in fields.items())


def line_of(message):
    """The bytes that the controller sends for this."""
    match message:
        case Reply(seq, fields):
            return seal(f"={seq} ok{written(fields)}")
        case Refusal(seq, code):
            return seal(f"={seq} err {code}")
        case Nak(code):
            return seal(f"=? err {code}")
        case Event(number, name, fields):
            return seal(f"!{number} {name}{written(fields)}")


MESSAGES = st.one_of(
    st.builds(Reply, SEQUENCES, FIELDS),
    st.builds(Refusal, SEQUENCES, st.integers(1, 14)),
    st.builds(Nak, st.sampled_from([2, 10])),
    st.builds(Event, SEQUENCES, NAMES, FIELDS),
)
STREAMS = st.lists(st.one_of(MESSAGES.map(line_of), st.binary(max_size=200)), max_size=6).map(b"".join)


def test_the_crc_is_that_of_the_document():
    assert crc(b"123456789") == 0x29B1


@pytest.mark.parametrize(("seq", "verb", "args", "line"), ENCODED)
def test_commands_byte_for_byte(seq, verb, args, line):
    assert encode(seq, verb, **args) == line


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"=17 ok*F4BB", Reply(17, {})),
        (b"=0 ok*506E", Reply(0, {})),
        (
            b"=1 ok proto=1 fw=1.0.0 boot=17 lease=1000 buf=96*8F0A",
            Reply(1, {"proto": "1", "fw": "1.0.0", "boot": "17", "lease": "1000", "buf": "96"}),
        ),
        (
            b"=65535 ok st=fault f=6 pos=-2147483648*8187",
            Reply(65535, {"st": "fault", "f": "6", "pos": "-2147483648"}),
        ),
        (b"=17 err 8*54CE", Refusal(17, 8)),
        (b"=0 err 1*4E69", Refusal(0, 1)),
        (b"=3 err 14*7EA8", Refusal(3, 14)),
        (b"=? err 2*F4E3", Nak(2)),
        (b"=? err 10*2F9B", Nak(10)),
        (
            b"!42 SHOT id=150 pos=1200 trg=300*5238",
            Event(42, "SHOT", {"id": "150", "pos": "1200", "trg": "300"}),
        ),
        (b"!1 BOOT why=2 boot=17*F2D1", Event(1, "BOOT", {"why": "2", "boot": "17"})),
        (b"!3 TESTED seq=9*D148", Event(3, "TESTED", {"seq": "9"})),
        (b"!7 HOMED seq=4 was=-461*A9C6", Event(7, "HOMED", {"seq": "4", "was": "-461"})),
        *(
            (line, Damaged(line))
            for line in (b"=17 ok*0000", b"=17 ok", b"=17 ok*f4bb", b"=17 ok*F4B", b"=? ok*", b"@17 STAT*811E")
        ),
    ],
)
def test_answers_byte_for_byte(line, message):
    assert decode(line) == message


def test_everything_that_the_firmware_answers_is_understood():
    answers = [step.answer for steps in dialogues().values() for step in steps if step.answer]
    assert len(answers) > 400
    for answer in answers:
        messages = LineReader().feed(answer)
        assert messages and not any(isinstance(message, Damaged) for message in messages), answer


@given(st.lists(MESSAGES, max_size=6))
@BUSY
def test_what_the_controller_says_is_understood(messages):
    assert LineReader().feed(b"".join(map(line_of, messages))) == messages


@given(STREAMS, st.lists(st.integers(0, 1000)))
@BUSY
def test_how_a_stream_is_cut_changes_nothing(stream, cuts):
    whole = LineReader().feed(stream)
    places = sorted({cut for cut in cuts if cut < len(stream)})
    reader = LineReader()
    pieces = [stream[a:b] for a, b in zip([0, *places], [*places, len(stream)], strict=True)]
    assert [message for piece in pieces for message in reader.feed(piece)] == whole


@pytest.mark.more
@given(st.lists(MESSAGES, min_size=1, max_size=4), st.data())
@settings(BUSY, max_examples=500)
def test_no_changed_byte_makes_another_message(messages, data):
    stream = b"".join(map(line_of, messages))
    place = data.draw(st.integers(0, len(stream) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda value: value != stream[place]))
    accepted = [
        message
        for message in LineReader().feed(stream[:place] + bytes([byte]) + stream[place + 1 :])
        if not isinstance(message, Damaged)
    ]
    # A changed byte is a burst of at most 8 bits, which a 16-bit CRC always sees: only losses, in order, are left.
    left = iter(messages)
    assert all(any(message == sent for sent in left) for message in accepted)
    assert len(accepted) >= len(messages) - 2


@pytest.mark.more
@given(MESSAGES.map(line_of), st.data())
@settings(BUSY, max_examples=500, derandomize=True, database=None)  # One such burst in 65536 is a collision of the CRC.
def test_no_lost_or_doubled_byte_makes_another_message(line, data):
    place = data.draw(st.integers(0, len(line) - 1))
    sent = LineReader().feed(line)
    lost = LineReader().feed(line[:place] + line[place + 1 :] + b"\n")
    doubled = LineReader().feed(line[:place] + line[place : place + 1] + line[place:])
    assert [m for m in lost + doubled if not isinstance(m, Damaged) and m not in sent] == []


@given(st.binary(max_size=2000))
@BUSY
def test_garbage_is_never_a_message(garbage):
    assert all(isinstance(message, Damaged) for message in LineReader().feed(garbage + b"\n"))


def test_a_line_without_an_end_takes_no_memory():
    reader = LineReader()
    for _ in range(1000):
        assert reader.feed(b"x" * 1000) == []
    (message,) = reader.feed(b"\n=17 ok*F4BB"[:1])
    assert isinstance(message, Damaged) and len(message.raw) <= 200
    assert reader.feed(b"=17 ok*F4BB\n") == [Reply(17, {})]


@pytest.mark.parametrize(
    "text",
    ["=017 ok", "=65536 ok", "=1 ok a=1 a=2", "=1 ok a=", "=1 ok  a=1", "=1 OK", "=1 err 02", "! BOOT", "=1 ok a=1=2"],
)
def test_lines_of_another_form_are_damaged(text):
    assert isinstance(decode(seal(text)[:-1]), Damaged)


@given(st.integers(1, 65535), NAMES, st.dictionaries(KEYS, st.integers(-(2**31), 2**31 - 1), max_size=3))
@BUSY
def test_encoded_lines_are_of_the_documents_form(seq, verb, args):
    try:
        line = encode(seq, verb, **args)
    except (ValueError, TypeError) as problem:
        assert "bytes, at most" in str(problem) or "multiple values" in str(problem)
        return
    body, _, digits = line[:-1].rpartition(b"*")
    assert int(digits, 16) == crc(body) and line.endswith(b"\n") and len(line) <= LONGEST_COMMAND + 1
    assert body.decode() == f"@{seq} {verb}{written(args)}"


@pytest.mark.parametrize(
    ("seq", "verb", "args"),
    [(0, "STAT", {}), (65536, "STAT", {}), (1, "MOVE", {"to": 2**31})],
)
def test_what_is_no_line_is_not_encoded(seq, verb, args):
    with pytest.raises(ValueError):
        encode(seq, verb, **args)


def test_no_flipped_bit_of_a_line_is_an_abort():
    of_lines = b"@=!?*-. \n\r0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
    assert all((byte ^ ABORT[0]).bit_count() >= 2 for byte in of_lines)
