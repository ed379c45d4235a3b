"""The terminal: colours only where they are wanted, and tables that fit."""

import io

import pytest

from jaxscan.cli.terminal import Terminal, table


SHEET = table("Sides", ("", "m", "sigma mm", "not parallel by"), [("length", "4.0013", "0.52", "0.010°"), ("width",)])


class Screen(io.StringIO):
    """A terminal, or a file."""

    def __init__(self, seen):
        super().__init__()
        self._seen = seen

    def isatty(self):
        return self._seen


@pytest.fixture
def printed(monkeypatch):
    """What is printed in an environment."""

    def call(text, *, seen, style="bold red", **environment):
        for name in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "TERM", "COLORTERM", "TTY_COMPATIBLE"):
            monkeypatch.delenv(name, raising=False)
        for name, value in {"TERM": "xterm-256color", **environment}.items():
            monkeypatch.setenv(name, value)
        screen = Screen(seen)
        monkeypatch.setattr("sys.stdout", screen)
        terminal = Terminal()
        terminal.print(text, style=style)
        return screen.getvalue(), terminal.is_terminal

    return call


@pytest.mark.parametrize("text", ["good to 1 mm", SHEET], ids=["line", "table"])
def test_colours_only_where_they_are_wanted(printed, text):
    assert "\x1b[" in printed(text, seen=True)[0]
    for environment in ({"NO_COLOR": "1"}, {"NO_COLOR": "1", "FORCE_COLOR": "1"}, {"TERM": "dumb"}):
        assert "\x1b" not in printed(text, seen=True, **environment)[0]
    assert "\x1b" not in printed(text, seen=False)[0]
    assert "\x1b[" in printed(text, seen=False, FORCE_COLOR="1")[0]
    # An empty NO_COLOR says nothing.
    assert "\x1b[" in printed(text, seen=True, NO_COLOR="")[0]


def test_forced_colours_make_no_terminal_of_a_file(printed):
    # Bars would fill it.
    assert not printed("line", seen=False, FORCE_COLOR="1")[1]
    assert printed("line", seen=True)[1] and not printed("line", seen=False)[1]


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("columns", [1, 10, 40, 60, 200])
def test_tables_fit_and_lose_nothing(printed, columns, seen):
    said, _ = printed(SHEET, seen=seen, COLUMNS=str(columns), NO_COLOR="1")
    assert "…" not in said
    for value in ("Sides", "length", "4.0013", "0.52", "0.010°", "width", "not parallel by"):
        assert value in said
    assert max(map(len, said.splitlines())) <= max(columns, 25)
    assert ("│" in said) == (columns >= 60)


def test_lines_are_not_folded(printed):
    # Printed paths and commands can be copied.
    command = "jaxscan reconstruct captures/room -c calibration.json -o room.ply"
    assert printed(command, seen=True, COLUMNS="20", NO_COLOR="1")[0] == command + "\n"


def test_a_control_character_in_a_table_is_escaped(printed):
    shown = table("a\x1b[2J", ("", "b\x07"), [("c\x1b", "d\x1b")])
    for columns in ("4", "80"):
        said, _ = printed(shown, seen=True, style="", COLUMNS=columns, NO_COLOR="1")
        assert "\x1b" not in said and "\x07" not in said and "\\x1b" in said
