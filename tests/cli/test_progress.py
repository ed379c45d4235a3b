"""The display of progress, and the jobs that another thread does ahead."""

import io
import threading
import time

import pytest
from rich.console import Console

from jaxscan.api.ahead import Ahead, tell
from jaxscan.cli import progress
from jaxscan.cli.progress import progress_bar
from jaxscan.errors import CalibrationError


class Screen(io.StringIO):
    """A terminal, and the times at which it was drawn on."""

    def __init__(self):
        super().__init__()
        self.changed = threading.Semaphore(0)

    def write(self, text):
        self.changed.release()
        return super().write(text)

    def isatty(self):
        return True


@pytest.fixture
def screen(monkeypatch):
    shown = Screen()

    class Shown:
        def __init__(self, *, stderr):
            self.console = Console(file=shown, force_terminal=True, width=120)
            self.is_terminal = True

    monkeypatch.setattr(progress, "Terminal", Shown)
    return shown


class Told:
    def __init__(self):
        self.words = []

    def __call__(self, done, total):
        pass

    def doing(self, words):
        self.words.append(words)


def test_the_display_moves_while_one_step_takes_long(screen):
    drawn = []

    def compile_slowly():
        # Ends when the screen was drawn on ten more times, however slow the machine is; never without a drawing thread.
        while screen.changed.acquire(blocking=False):
            pass
        for _ in range(10):
            drawn.append(screen.changed.acquire(timeout=60))

    with progress_bar("Calibrating") as bar, Ahead([("solver", compile_slowly), ("verdict", lambda: None)]) as ahead:
        bar(0, 100)
        ahead.wait("verdict", bar)
    assert drawn == [True] * 10
    assert "Calibrating: compiling 1 of 2: solver" in screen.getvalue()
    assert "0/100" in screen.getvalue()


def test_nothing_is_counted_before_the_number_is_known(screen):
    with progress_bar("Rendering") as bar:
        bar.doing("reading [red]the room[/red]")
        while "reading" not in screen.getvalue():
            screen.changed.acquire(timeout=60)
    shown = screen.getvalue()
    assert "?" not in shown.replace("\x1b[?25", "") and "0/" not in shown
    assert "[red]the room" in shown


def test_an_error_ahead_is_a_warning_and_the_others_go_on():
    def broken():
        raise ValueError("no such shape")

    done = []
    with (
        pytest.warns(RuntimeWarning, match=r"compiling ahead \(first\) failed.*ValueError: no such shape") as heard,
        Ahead([("first", broken), ("second", lambda: done.append(1))]) as ahead,
    ):
        ahead.wait("second")
        ahead.wait("unknown")
    assert done == [1] and len(heard) == 1


def test_a_rehearsal_that_refuses_its_input_is_no_error():
    def refused():
        raise CalibrationError("No board.")

    with Ahead([("solver", refused)]) as ahead:
        ahead.wait("solver")


def test_leaving_by_an_error_waits_for_nothing():
    held, begun, others = threading.Event(), threading.Event(), []

    def slow():
        begun.set()
        held.wait(60)

    try:
        with pytest.raises(KeyboardInterrupt), Ahead([("slow", slow), ("other", lambda: others.append(1))]):
            begun.wait(60)
            raise KeyboardInterrupt
        # Here although the job has not ended.
        assert not held.is_set()
    finally:
        held.set()
    time.sleep(0.01)
    assert others == []


def test_words_reach_only_those_who_listen():
    told = Told()
    tell(told, "solving")
    tell(None, "solving")
    tell(lambda done, total: None, "solving")
    assert told.words == ["solving"]
