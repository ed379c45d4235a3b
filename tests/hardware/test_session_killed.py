"""Real firmware in a simulated processor, real processes, real signals: the capture left by a session that is ended."""

import json
import os
import random
import signal
import time
from functools import partial

import numpy as np
import pytest
from scanrig.recording import AHEAD

from jaxscan.files.capture import open_capture, verify_capture

from .scanning import forked, see, session


class Scan:
    """A sweep of a simulated rig that is begun, ended from outside, and gone on with."""

    def __init__(self, simulated, folder, steps, *, gige=False):
        self.simulated, self.folder, self.steps, self.gige = simulated, folder, steps, gige
        self.said = folder.with_suffix(".said")
        self.said.touch()

    def begin(self):
        """The process of a session."""
        order = {"folder": self.folder, "steps": self.steps, "said": self.said, "gige": self.gige}
        return forked(partial(session, port=self.simulated.port, edges=self.simulated.edges_path, **order))

    def end(self, child):
        """How the session's process ended."""
        child.join(120)
        return child.exitcode

    def require_complete(self):
        """Go on to the end."""
        assert self.end(self.begin()) == 0, self.words()

    def words(self):
        return self.said.read_text().splitlines()

    def pairs(self):
        """Numbers of the pairs that were handed out as safely stored."""
        return [int(line) for line in self.words() if line.isdigit()]

    def await_pairs(self, count, within_s=60.0):
        end = time.monotonic() + within_s
        while len(self.pairs()) < count:
            assert time.monotonic() < end, self.words()
            time.sleep(0.005)

    def events(self, name):
        return [line for line in self.journal() if line.get("event") == name]

    def journal(self):
        lines = (self.folder / "frames.jsonl").read_text().split("\n")
        return [json.loads(line) for line in lines if line.endswith("}")]

    def require_whole(self):
        """All records are there once, their files are unaltered, and show the table's true position."""
        assert verify_capture(self.folder) == []
        capture = open_capture(self.folder)
        assert [record.i for record in capture.records] == list(range(self.steps))
        np.testing.assert_allclose(capture.angles, np.radians(0.1 * np.arange(self.steps)), atol=1e-9)
        generator = np.random.default_rng(0)
        for k in range(self.steps):
            for frame, lit in zip(capture.frames(k), (True, False), strict=True):
                true = see(8 * k, lit, generator)
                # Noise makes 1.5 DN; three steps aside, or the laser, make more than 3.
                assert np.abs(frame.astype(int) - true.astype(int)).mean() < 2.2

    def require_dark(self):
        plant = self.simulated.plant()
        assert not plant["laser"] and not plant["contactor"], plant


@pytest.fixture
def scan(rig, tmp_path):
    def make(steps, **options):
        return Scan(rig(speed=10, **options), tmp_path / "room", steps)

    return make


def kill_and_go_on(scan, kills, seed):
    """Kill sessions at random moments, and check the capture after each. Returns the number killed in mid-sweep."""
    generator, during = random.Random(seed), 0
    for _ in range(kills):
        before = len(scan.pairs())
        child = scan.begin()
        # At any moment of the start, or when some pairs are there.
        wanted = before + generator.choice([0, 0, 1, 2, 3, 5])
        end = time.monotonic() + 60
        while wanted > before and len(scan.pairs()) < wanted and time.monotonic() < end:
            if "complete" in scan.words():
                break
            time.sleep(0.001)
        time.sleep(generator.uniform(0.0, 0.4 if wanted == before else 0.08))
        os.kill(child.pid, signal.SIGKILL)
        status = scan.end(child)
        assert status in (-signal.SIGKILL, 0), scan.words()
        during += status != 0 and len(scan.pairs()) > before
        if not (scan.folder / "capture.toml").exists():
            assert scan.pairs() == []
            continue
        # Whatever was said to be stored is stored, and whole; a torn last line is the shot in flight.
        stored = {line["i"] for line in scan.journal() if "i" in line}
        assert set(scan.pairs()) <= stored
        assert [problem for problem in verify_capture(scan.folder) if problem.record is not None] == []
        # And no more than those that were in flight were not said.
        assert len(stored - set(scan.pairs())) <= (1 + AHEAD) * kills
    return during


def test_09_killed_at_any_moment_it_goes_on(scan):
    """Faults 9 and 21: kill -9, a few times."""
    one = scan(30)
    assert kill_and_go_on(one, 4, seed=1) >= 1
    one.require_complete()
    one.require_whole()
    one.require_dark()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_09_killed_fifty_times_it_goes_on(rig, tmp_path):
    """Fault 9, 50 times over: every scan is complete in the end, every hash right."""
    simulated, kills, during = rig(speed=10), 0, 0
    for number in range(5):
        one = Scan(simulated, tmp_path / f"room{number}", 60)
        during += kill_and_go_on(one, 10, seed=100 + number)
        kills += 10
        one.require_complete()
        one.require_whole()
        one.require_dark()
    assert kills == 50 and during >= 20, during


@pytest.mark.parametrize(
    "name", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.slow), pytest.param("SIGHUP", marks=pytest.mark.slow)]
)
def test_10_one_signal_ends_after_the_step(scan, name):
    one = scan(30)
    child = one.begin()
    one.await_pairs(5)
    os.kill(child.pid, getattr(signal, name))
    assert one.end(child) == 130, one.words()
    assert one.words()[-1] == "interrupted"
    one.require_dark()
    assert verify_capture(one.folder) == []
    end = one.journal()[-1]
    assert (end["event"], end["status"], end["laser_off"]) == ("end", "interrupted", True)
    # The step it came in was finished: no exposure without its record.
    edges = one.simulated.edges()
    exposures = sum(edge.get("pin") == "trig" and edge["v"] == 1 for edge in edges)
    assert exposures == 2 * len(one.pairs())
    one.require_complete()
    one.require_whole()


def test_10_two_signals_abort_at_once(scan):
    one = scan(30)
    child = one.begin()
    one.await_pairs(5)
    os.kill(child.pid, signal.SIGINT)
    time.sleep(0.004)
    os.kill(child.pid, signal.SIGINT)
    assert one.end(child) == 130, one.words()
    one.require_dark()
    said = [line for line in one.words() if not line.startswith("#")][-1]
    # On a busy machine the step may have ended between the two.
    assert said in ("aborted", "interrupted")
    if said == "aborted":
        assert one.journal()[-1]["status"] == "aborted"
    assert verify_capture(one.folder) == []
    one.require_complete()
    one.require_whole()


def test_06_cable_pulled_from_real_firmware(scan):
    """Fault 6: the port goes away in mid-scan and comes back; position and boot are the old ones."""
    one = scan(30)
    child = one.begin()
    one.await_pairs(5)
    one.simulated.unplug()
    time.sleep(0.5)
    one.simulated.plug()
    assert one.end(child) == 0, one.words()
    (back,) = one.events("reconnected")
    assert back["same_boot"] is True
    one.require_whole()
    one.require_dark()


def test_07_reset_of_real_firmware(scan):
    """Fault 7: somebody presses the controller's button in mid-scan."""
    one = scan(30)
    child = one.begin()
    one.await_pairs(5)
    one.simulated.control("reset")
    assert one.end(child) == 0, one.words()
    assert one.events("start")[0]["boot"] < one.simulated.plant()["resets"] + one.events("start")[0]["boot"]
    assert [event["why"] for event in one.events("home")] == ["start", "after a fault", "end of a pass"]
    one.require_whole()
    one.require_dark()


def test_13_steps_dropped_by_the_driver(scan):
    """Fault 13: the driver misses steps; the counter at home tells."""
    one = scan(30)
    child = one.begin()
    one.await_pairs(10)
    one.simulated.control("drop 9")
    assert one.end(child) == 1, one.words()
    assert one.words()[-1] == "suspect"
    (event,) = one.events("suspect")
    assert event["records"] == [[0, 29]] and abs(event["missed"]) == 9
    one.require_dark()
