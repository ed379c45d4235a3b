"""Nothing that is printed can steer a terminal."""

import sys
import unicodedata

import pytest

from jaxscan.printable import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mred", r"\x1b[31mred"),
        ("\x1b]52;c;aGk=\x07", r"\x1b]52;c;aGk=\x07"),
        ("\x9b31m", r"\x9b31m"),
        ("del\x7f", r"del\x7f"),
        ("two\nlines\tand\r", r"two\nlines\tand\r"),
        ("\u202etxt.exe", r"\u202etxt.exe"),
        ("\u2066\u200b\ufeff", r"\u2066\u200b\ufeff"),
        ("\u2028\u2029", r"\u2028\u2029"),
        ("caf\udce9.ply", r"caf\udce9.ply"),
        ("\ud83d", r"\ud83d"),
        ("\U000e0001", r"\U000e0001"),
        ("a\x00b", r"a\x00b"),
    ],
)
def test_commands_become_visible(text, shown):
    assert printable(text) == shown


@pytest.mark.parametrize("text", ["", "room 3.ply", "2.50 µm → 20° ± 3 ‰", "C:\\scans\\room", "Größe 部屋 комната 🙂"])
def test_text_stays_as_it_is(text):
    assert printable(text) is text


def test_no_character_of_unicode_passes_that_is_not_shown():
    for first in range(0, sys.maxunicode + 1, 4096):
        shown = printable("".join(map(chr, range(first, first + 4096))))
        assert shown.isprintable(), hex(first)
        shown.encode("utf-8")
    commands = [c for c in map(chr, range(sys.maxunicode + 1)) if unicodedata.category(c) in COMMANDS]
    assert len(commands) > 2048
    for c in commands:
        shown = printable(c)
        assert shown.startswith("\\") and shown.isascii(), hex(ord(c))


COMMANDS = {"Cc", "Cf", "Cs", "Zl", "Zp"}
