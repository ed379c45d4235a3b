"""Jobs that another thread does ahead, and the words by which a display is told."""

import threading

import pytest

from jaxscan.api import rehearsal as rehearsals
from jaxscan.api.ahead import Ahead, tell
from jaxscan.calibration import CalibrationSettings
from jaxscan.errors import CalibrationError
from jaxscan.files.capture import common_board, open_capture


class Told:
    """A progress callback that keeps the words it is told."""

    def __init__(self):
        self.words = []

    def doing(self, words):
        self.words.append(words)


def test_waiting_says_which_job_is_being_done():
    told, held = Told(), threading.Event()

    def slow():
        assert held.wait(60)

    class Listener(Told):
        def doing(self, words):
            told.doing(words)
            # Told for the second time while the job lasts, so words keep coming.
            if len(told.words) == 2:
                held.set()

    with Ahead([("solver", slow), ("verdict", lambda: None)]) as ahead:
        ahead.wait("solver", Listener())
    assert told.words[:2] == ["compiling 1 of 2: solver"] * 2


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
    # The job that had not begun never does.
    for thread in threading.enumerate():
        if thread.name.startswith("ahead"):
            thread.join(60)
    assert others == []


def test_words_reach_only_those_who_listen():
    told = Told()
    tell(told, "solving")
    tell(None, "solving")
    tell(lambda done, total: None, "solving")
    assert told.words == ["solving"]


def test_code_that_is_kept_on_disk_is_not_rehearsed_again(tiny, kept, monkeypatch):
    captures = [open_capture(tiny.boards)]
    board = common_board(captures, single_lasers=True)
    monkeypatch.setattr(rehearsals, "calibrate_observations", lambda *_, **__: None)

    def rehearse(*, in_another_process):
        if in_another_process:
            monkeypatch.setattr(rehearsals, "_rehearsed", set())
        return rehearsals.rehearsal(captures, board, CalibrationSettings(), stripes=True)

    ((_, job),) = rehearse(in_another_process=True)
    assert rehearse(in_another_process=False) == []
    # Another process does not wait for the first one's end.
    assert rehearse(in_another_process=True) != []
    job()
    assert rehearse(in_another_process=True) == []
    # A cache that was emptied, and one that cannot be written to.
    (note,) = kept.iterdir()
    note.unlink()
    kept.rmdir()
    ((_, job),) = rehearse(in_another_process=True)
    job()
    assert rehearse(in_another_process=True) != []
