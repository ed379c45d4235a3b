"""Proving and writing while the table turns: what overlaps, what is returned to, and what a death in between costs."""

import os
import signal
import threading
from itertools import pairwise

import numpy as np
import pytest
from scanrig.cameras.simulated import FrameShape, draw
from scanrig.errors import FrameError
from scanrig.recording import AHEAD
from scanrig.session import session, steps

from jaxscan.files import recording
from jaxscan.files.capture import open_capture, verify_capture

from .desk import HEIGHT, WIDTH, Desk, journal, records
from .scanning import forked


class StillDesk(Desk):
    """The same picture whenever the table stands at the same place; notes where the table goes."""

    def __init__(self, **tables):
        super().__init__(**tables)
        self.way = []
        shot, move = self.controller.shot, self.controller.move
        self.controller.shot = lambda to, *rest, **keys: (self.way.append(to), shot(to, *rest, **keys))[1]
        self.controller.move = lambda to, *rest: (self.way.append(to), move(to, *rest))[1]

    def see(self, position, lit):
        generator = np.random.default_rng([int(position) + 10**6, int(lit)])
        return draw(self.scene, position, lit, FrameShape(WIDTH, HEIGHT), generator)


def dark_at(desk, *shots):
    """The laser is dark in these shots, counted from 1."""
    for shot in shots:
        desk.controller.before_shot[shot] = lambda controller: setattr(desk.table, "dead", True)
        if shot + 1 not in shots:
            desk.controller.before_shot[shot + 1] = lambda controller: setattr(desk.table, "dead", False)


# What overlaps


def test_proof_and_disk_cost_no_time_on_the_rigs_clock(tmp_path, monkeypatch):
    """The bench's clock, with a proof and a disk that take 25 and 95 ms of it beside the steps, as they do on a slow
    computer: a sweep takes not a microsecond longer than with ones that take none, but one after the other."""

    def duration(name, proof_s, write_s):
        desk = Desk(sweep={"steps": 30, "turn_deg": 30.0})
        clock, ends = desk.clock, {"proof": [0.0], "write": [0.0]}

        class Timed(steps.Flights):
            def begin(self, *arguments):
                ends["proof"].append(max(clock.now(), ends["proof"][-1]) + proof_s)
                ends["write"].append(max(ends["proof"][-1], ends["write"][-1]) + write_s)
                super().begin(*arguments)

            def verdict(self):
                clock.time_s = max(clock.time_s, ends["proof"][-1])
                return super().verdict()

            def landed(self, most=AHEAD):
                clock.time_s = max(clock.time_s, ends["write"][max(0, len(ends["write"]) - 1 - most)])
                return super().landed(most)

        monkeypatch.setattr(session, "Flights", Timed)
        assert desk.sweep(tmp_path / name).status == "complete"
        times = [record["time_s"] for record in records(tmp_path / name)]
        return np.diff(times)

    alone, beside = duration("alone", 0.0, 0.0), duration("beside", 0.025, 0.095)
    np.testing.assert_allclose(beside, alone, atol=2e-6)
    # A disk that is slower than the table is waited for, once the table is ahead, and nothing else is.
    slow = duration("slow", 0.025, 0.5)
    np.testing.assert_allclose(slow[AHEAD + 3 :], 0.5, atol=2e-6)


def test_a_proof_may_end_after_the_next_step_was_taken(tmp_path, monkeypatch):
    desk, shots, prove = Desk(), threading.Condition(), steps.prove
    shot, begun = desk.controller.shot, []

    def counting(to, id, **keys):
        shot(to, id, **keys)
        with shots:
            begun.append(id)
            shots.notify_all()

    def late(taken, config):
        with shots:
            assert shots.wait_for(lambda: len(begun) > taken.position // 288 + 1 or len(begun) == 10, timeout=60)
        return prove(taken, config)

    desk.controller.shot = counting
    monkeypatch.setattr(steps, "prove", late)
    assert desk.sweep(tmp_path / "room").status == "complete"
    assert [record["i"] for record in records(tmp_path / "room")] == list(range(10))


# What is returned to


@pytest.mark.parametrize("turn_deg", [36.0, -36.0])
@pytest.mark.parametrize(
    ("dark", "order"),
    [
        ((1,), [1, 0, *range(2, 10)]),
        ((4,), [0, 1, 2, 4, 3, *range(5, 10)]),
        ((4, 5), [0, 1, 2, 3, 4, *range(5, 10)]),
        ((10,), [*range(10)]),
    ],
)
def test_a_step_noticed_late_is_returned_to_from_the_same_side(tmp_path, turn_deg, dark, order):
    plain, desk = (StillDesk(sweep={"turn_deg": turn_deg}) for _ in range(2))
    assert plain.sweep(tmp_path / "plain").status == "complete"
    dark_at(desk, *dark)
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.records, result.retakes) == ("complete", 10, len(dark))
    assert [record["i"] for record in records(tmp_path / "room")] == order
    # Each place is reached as the first time, by the same motion from the same side; then the table goes on.
    step = 288 if turn_deg > 0 else -288
    # The first step is reached by homing, from above: nothing comes before it.
    for shot in set(dark) - {1}:
        motions = [pair for pair in pairwise(desk.way) if pair[1] == step * (shot - 1) != pair[0]]
        assert len(motions) == (1 if shot == 10 else 2)
        assert all(pair[0] == step * (shot - 2) for pair in motions), motions
    # And the capture is that of the undisturbed scan.
    first, other = (open_capture(tmp_path / name) for name in ("plain", "room"))
    assert [record.i for record in other.records] == [record.i for record in first.records]
    np.testing.assert_array_equal(first.angles, other.angles)
    for k in range(10):
        np.testing.assert_array_equal(np.stack(first.frames(k)), np.stack(other.frames(k)))
    assert verify_capture(tmp_path / "room") == []


def test_a_request_to_end_waits_until_the_last_step_is_proven(tmp_path):
    desk, asked = StillDesk(), []
    dark_at(desk, 5)
    result = desk.sweep(tmp_path / "room", should_stop=lambda: asked.append(1) or len(asked) > 5)
    assert (result.status, result.records, result.retakes) == ("interrupted", 5, 1)
    assert desk.controller.shots == [0, 288, 576, 864, 1152, 1152]


def test_a_step_that_is_never_proven_is_the_one_that_is_named(tmp_path):
    """Also where the step after it fails in another way."""
    desk = StillDesk(checks={"retakes": 2})
    dark_at(desk, *range(4, 40))
    desk.camera.faults.update(dict.fromkeys(range(9, 15), "missing"))
    with pytest.raises(FrameError, match=r"step 3: not proven in 3 takes.*laser is dark"):
        desk.sweep(tmp_path / "room")
    assert [record["i"] for record in records(tmp_path / "room")] == [0, 1, 2]
    assert not desk.table.laser and not desk.table.contactor


# What a death in between costs


def killed(at, folder):
    """A sweep that kills its process while the fourth pair is proven, written or noted."""
    desk, begun = Desk(), threading.Event()
    desk.controller.before_shot[5] = lambda controller: begun.set()

    def die():
        begun.wait(60)  # The next step is being taken by then, and those before are on the disk.
        while b'"i": 2,' not in (folder / "frames.jsonl").read_bytes():
            pass
        os.kill(os.getpid(), signal.SIGKILL)

    prove, write, append = steps.prove, recording.write_atomically, recording.append_whole

    def proving(taken, *rest):
        return die() if at == "proving" and taken.position == 3 * 288 else prove(taken, *rest)

    def writing(path, content, **keys):
        return die() if at == "writing" and str(path).endswith("off/000003.zst") else write(path, content, **keys)

    def appending(file, line, **keys):
        return die() if at == "appending" and b'"i": 3,' in line else append(file, line, **keys)

    steps.prove, recording.write_atomically, recording.append_whole = proving, writing, appending
    desk.sweep(folder)


@pytest.mark.more
@pytest.mark.parametrize("at", ["proving", "writing", "appending"])
def test_killed_between_the_frames_and_the_journal_only_the_flight_is_lost(tmp_path, at):
    child = forked(killed, at, tmp_path / "room")
    child.join(120)
    assert child.exitcode == -signal.SIGKILL
    assert [record["i"] for record in records(tmp_path / "room")] == [0, 1, 2]
    assert [problem for problem in verify_capture(tmp_path / "room") if problem.record is not None] == []
    again = Desk()
    assert again.sweep(tmp_path / "room", resume=True).status == "complete"
    assert verify_capture(tmp_path / "room") == [] and len(open_capture(tmp_path / "room")) == 10


@pytest.mark.parametrize("where", ["prove", "fields"])
def test_an_error_in_the_background_comes_out_as_it_is(tmp_path, monkeypatch, where):
    desk = Desk()
    target, name = (steps, "prove") if where == "prove" else (session, "record_fields")
    original, calls = getattr(target, name), []

    def fails(*arguments):
        calls.append(1)
        if len(calls) == 4:
            raise ValueError("a defect")
        return original(*arguments)

    monkeypatch.setattr(target, name, fails)
    with pytest.raises(ValueError, match=r"^a defect$"):
        desk.sweep(tmp_path / "room")
    assert not desk.table.laser and not desk.table.contactor
    assert [record["i"] for record in records(tmp_path / "room")] == [0, 1, 2]
    end = journal(tmp_path / "room")[-1]
    assert (end["status"], end["problem"], end["laser_off"]) == ("failed", "ValueError: a defect", True)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("scanrig")]
    assert Desk().sweep(tmp_path / "room", resume=True).status == "complete"


def test_no_thread_and_no_lock_is_left_by_any_end(tmp_path):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: controller.lose_link(attempts=1000)
    with pytest.raises(Exception, match="did not come back"):
        desk.sweep(tmp_path / "room")
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("scanrig")]
    assert sorted(os.listdir(tmp_path / "room")) == ["capture.toml", "frames.jsonl", "off", "on"]
