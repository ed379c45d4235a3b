"""Threads of the console outlive an exception, and say it."""

import threading
import time

from jaxscan.cli.console.silence import Silence
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.works import Work, Works


def says(slate):
    return [line["says"] for line in slate.state(0)[1]["lines"]]


def test_a_work_that_fails_takes_no_other_with_it(monkeypatch):
    slate, ended = Slate(), threading.Event()

    def call(works, words, lines):
        if "broken" in words:
            raise OSError(24, "Too many open files")
        return 0

    def fail(well, result):
        raise ValueError("no such\ncapture")

    monkeypatch.setattr(Works, "_call", call)
    with Works(slate) as works:
        works.begin(Work("reconstruct room", ["broken"]))
        works.begin(Work("calibrate boards", ["well"], fail))
        works.begin(Work("compare", ["well"], lambda well, result: ended.set()))
        assert ended.wait(30)
        while works.busy:
            time.sleep(0.01)
    assert says(slate) == [
        "reconstruct room: did not succeed: [Errno 24] Too many open files",
        "calibrate boards: did not succeed: no such capture",
    ]
    found = {one["what"]: (one["running"], one["well"]) for one in slate.read("works")}
    assert found == {
        "reconstruct room": (False, False),
        "calibrate boards": (False, True),
        "compare": (False, True),
    }


def test_the_watch_over_the_rig_goes_on_and_says_a_failure_once(paper, monkeypatch):
    slate, looks, enough = Slate(), [], threading.Event()

    def look(silence):
        looks.append(1)
        if len(looks) < 4:
            raise OSError(24, "Too many open files")
        enough.set()
        return "the controller is silent"

    monkeypatch.setattr(Silence, "look", look)
    monkeypatch.setattr("jaxscan.cli.console.silence._BETWEEN_S", 0.01)
    with Silence(slate, paper.controller):
        assert enough.wait(30)
    assert says(slate) == ["the watch over the rig: did not succeed: [Errno 24] Too many open files"]
