"""Progress moves while nothing is done, and says what is being done."""

import io
import threading
from pathlib import Path

import pytest
from rich.console import Console

from jaxscan.api.stages import Stage, Stages
from jaxscan.cli import paces, progress
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
    assert "%" not in screen.getvalue()


def test_says_what_is_being_done_and_how_much_is_done(screen):
    with progress.progress_bar("Looking") as shown:
        shown.doing("fitting")
        shown(3, 50)
        assert screen.wait_for("Looking: fitting", "6 %")


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
            assert screen.wait_for("solving again", "25 %")


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
    monkeypatch.setattr(progress, "Remaining", lambda **_: remaining)
    with progress.progress_bar("Calibrating") as shown:
        for done in range(21):
            shown(done, 20)
            clock[0] += 4.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Calibrating: 10 %, about 72 s left" and lines[-1] == "Calibrating: 90 %, about 8 s left"


def test_a_terminal_is_told_the_time_that_is_left_after_a_tenth(screen, monkeypatch):
    clock = [0.0]
    remaining = progress.Remaining(lambda: clock[0])
    monkeypatch.setattr(progress, "Remaining", lambda **_: remaining)
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
    assert told == [(0, 10000), (3100, 10000), (4000, 10000), (4000, 10000), (8000, 10000), (10000, 10000)]
    assert Stages(None, (Stage(1.0),)).part(0) is None
    Stages(None, (Stage(1.0),)).done(0)
    # Where the stages take what they say, the time that is left is right from the first part on.
    clock = [0.0]
    remaining = progress.Remaining(lambda: clock[0])
    clock[0] = 2 * 3.1
    assert remaining(*told[1]) == pytest.approx(2 * 6.9, rel=0.03)


@pytest.fixture
def clocks(monkeypatch, tmp_path):
    """A clock and that of the processor, as tests set them, and nothing remembered."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock = {"wall": 0.0, "worked": 0.0}
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock["wall"])
    monkeypatch.setattr(progress.time, "process_time", lambda: clock["worked"])
    return clock


def test_a_second_run_is_estimated_by_the_processor_time_of_the_first(clocks):
    """On a processor that others use, with twice the work, and during a stage that says nothing."""
    with progress.progress_bar("Solving") as shown:
        shown(0, 10)
        clocks["wall"], clocks["worked"] = 50.0, 20.0
        shown(10, 10)
    assert paces.pace_of("Solving") == 2.0 and paces.pace_of("Looking") is None
    remaining = progress.Remaining(lambda: clocks["wall"], pace=2.0, worked=lambda: clocks["worked"])
    assert remaining(0, 20) is None
    clocks["wall"], clocks["worked"] = 50.0 + 40.0, 20.0 + 10.0
    assert remaining(1, 20) == pytest.approx(4 * 30.0)
    # Half of it was kept from before.
    assert remaining(10, 20) == pytest.approx(4 * 20.0)
    # It takes more than before: by what is done, as in a first run.
    clocks["wall"], clocks["worked"] = 50.0 + 200.0, 20.0 + 50.0
    assert remaining(10, 20) == pytest.approx(200.0)


def test_what_fails_is_not_remembered(clocks):
    with pytest.raises(KeyError), progress.progress_bar("Solving") as shown:
        shown(1, 2)
        clocks["worked"] = 3.0
        raise KeyError
    assert paces.pace_of("Solving") is None


@pytest.mark.parametrize(
    "content", ["", "[1]", '{"Solving": "2"}', '{"Solving": -1.0}', '{"Solving": NaN}', "[" * 10**5]
)
def test_a_damaged_memory_is_none(clocks, content, tmp_path):
    file = tmp_path / "jaxscan" / "paces.json"
    file.parent.mkdir()
    file.write_text(content)
    assert paces.pace_of("Solving") is None
    paces.remember_pace("Solving", 2.0)
    assert paces.pace_of("Solving") == 2.0


@pytest.mark.parametrize("folder", [None, "/dev/null/jaxscan"])
def test_no_place_to_remember_is_no_fault(monkeypatch, folder):
    monkeypatch.setattr(paces, "cache_folder", lambda: folder and Path(folder))
    paces.remember_pace("Solving", 2.0)
    assert paces.pace_of("Solving") is None


def test_the_memory_does_not_grow(clocks):
    for number in range(60):
        paces.remember_pace(f"task {number}", 1.0 + number)
    assert paces.pace_of("task 0") is None and paces.pace_of("task 59") == 60.0
