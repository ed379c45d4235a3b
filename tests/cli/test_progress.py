"""Progress moves while nothing is done, and says what is being done."""

import io
import threading

import pytest
from rich.console import Console

from jaxscan.api.stages import Stage, Stages
from jaxscan.cli import progress
from jaxscan.cli.scan_display import ScanDisplay


PATIENCE_S = 60


class Screen(io.StringIO):
    """A terminal that tells when some words were printed."""

    def __init__(self):
        super().__init__()
        self.printed = threading.Condition()

    def write(self, text):
        with self.printed:
            self.printed.notify_all()
            return super().write(text)

    def wait_for(self, *words):
        with self.printed:
            return self.printed.wait_for(lambda: all(word in self.getvalue() for word in words), PATIENCE_S)


@pytest.fixture
def screen(monkeypatch):
    screen = Screen()

    class Fake:
        is_terminal = True
        console = Console(file=screen, force_terminal=True, width=100, color_system=None)

        def __init__(self, *, stderr):
            assert stderr

    monkeypatch.setattr(progress, "Terminal", Fake)
    return screen


def test_the_wheel_turns_and_the_seconds_count_during_one_slow_step(screen):
    with pytest.raises(KeyError), progress.progress_bar("Looking"):
        assert screen.wait_for("- Looking", "| Looking", "0:00:00", "0:00:01")
        raise KeyError
    assert "/?" not in screen.getvalue()


def test_says_what_is_being_done_and_how_much_is_done(screen):
    with progress.progress_bar("Looking") as shown:
        shown.doing("fitting")
        shown(3, 50)
        assert screen.wait_for("Looking: fitting", "3/50")


def test_without_a_terminal_nothing_is_printed(capsys):
    with progress.progress_bar("Looking") as shown:
        shown.doing("fitting")
        shown(1, 2)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("width", [1, 40])
def test_a_narrow_terminal_sees_the_stage(monkeypatch, width):
    screen = Screen()

    class Narrow:
        is_terminal = True
        console = Console(file=screen, force_terminal=True, width=width, color_system=None)

        def __init__(self, **_):
            pass

    monkeypatch.setattr(progress, "Terminal", Narrow)
    with progress.progress_bar("Calibrating") as shown:
        shown(1, 4)
        shown.doing("solving again, with a verdict")
        if width == 40:
            assert screen.wait_for("solving again", "1/4")


def test_a_scan_in_a_log_says_how_long_it_takes(capsys):
    """A line after each tenth, with the time that is left at the rate so far; none where it goes fast."""
    clock = [0.0]
    display = ScanDisplay(total=40, now=lambda: clock[0])
    for done in range(41):
        display.progress(done, 40)
        clock[0] += 3.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "4 of 40 records, about 2 min left"
    assert [line.split()[0] for line in lines] == ["4", "8", "12", "16", "20", "24", "28", "32", "36"]
    assert lines[-1] == "36 of 40 records, about 12 s left"
    fast = ScanDisplay(total=40, now=lambda: clock[0])
    for done in range(41):
        fast.progress(done, 40)
        clock[0] += 0.1
    assert capsys.readouterr().err == ""


def test_what_takes_long_says_in_a_log_how_long(capsys, monkeypatch):
    clock = [0.0]
    remaining = progress.Remaining(lambda: clock[0])
    monkeypatch.setattr(progress, "Remaining", lambda: remaining)
    with progress.progress_bar("Calibrating") as shown:
        for done in range(21):
            shown(done, 20)
            clock[0] += 4.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Calibrating: 10 %, about 72 s left" and lines[-1] == "Calibrating: 90 %, about 8 s left"


def test_a_terminal_is_told_the_time_that_is_left_after_a_tenth(screen, monkeypatch):
    clock = [0.0]
    remaining = progress.Remaining(lambda: clock[0])
    monkeypatch.setattr(progress, "Remaining", lambda: remaining)
    with progress.progress_bar("Looking") as shown:
        shown(1, 20)
        clock[0] = 20.0
        shown(2, 20)
        assert screen.wait_for("about 3 min left")
    assert screen.getvalue().count("left") == screen.getvalue().count("about 3 min left")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(12.3, "12 s"), (100.0, "1.5 min"), (200.0, "3.5 min"), (601.0, "11 min"), (7300.0, "2 h 2 min")],
)
def test_durations(seconds, words):
    assert progress.duration(seconds) == words


def test_stages_of_different_cost_are_one_progress():
    told = []
    stages = Stages(lambda done, total: told.append((done, total)), (Stage(3.0, 1.0), Stage(0.0), Stage(2.0, 4.0)))
    stages.part(0)(0, 10)
    stages.part(0)(1, 10)
    stages.part(0)(10, 10)
    stages.done(1)
    stages.part(2)(1, 2)
    stages.done(2)
    assert told == [(0, 100), (31, 100), (40, 100), (40, 100), (80, 100), (100, 100)]
    assert Stages(None, (Stage(1.0),)).part(0) is None
    Stages(None, (Stage(1.0),)).done(0)
    # Where the stages take what they say, the time that is left is right from the first part on.
    clock = [0.0]
    remaining = progress.Remaining(lambda: clock[0])
    clock[0] = 2 * 3.1
    assert remaining(*told[1]) == pytest.approx(2 * 6.9, rel=0.03)
