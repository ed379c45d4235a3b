"""Two lasers on paper: a step is taken with one after the other; each pair is proven, noted and resumed for itself."""

import itertools
from types import SimpleNamespace

import pytest
from scanrig.controllers.controller import Settings
from scanrig.controllers.jxs.controller import JxsController
from scanrig.errors import FirmwareError, FrameError
from scanrig.session.plan import controller_settings, estimate, placed_targets, placement_positions, plan_sweep

from jaxscan.files.capture import open_capture

from .desk import After, Desk, events, records, rig_config
from .fake import FakeController


BOTH = [{"name": "left", "on_ms": 20}, {"name": "right", "on_ms": 35, "off_ms": 10}]
BOARD = {"type": "chessboard", "columns": 9, "rows": 6, "square_mm": 60.0}
VIEWS = {"free_views": 2, "placements": 1, "angles_deg": [-10.0, 0.0, 10.0]}


def shots_of(desk):
    """Record and laser of each shot from now on."""
    lit, shot = [], desk.controller.shot
    desk.controller.shot = lambda to, id, *, number=1: (lit.append((id, number)), shot(to, id, number=number))
    return lit


def test_each_step_is_taken_with_one_laser_after_the_other(tmp_path):
    desk = Desk(laser=BOTH)
    lit = shots_of(desk)
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.records, result.planned) == ("complete", 20, 20)
    assert lit == [*((k, 1 + k % 2) for k in range(20)), (0, 1)]
    found = records(tmp_path / "room")
    assert [one["lasers"] for one in found] == [["left"], ["right"]] * 10
    assert [one["microsteps"] for one in found] == [288 * (k // 2) for k in range(20)]
    capture = open_capture(tmp_path / "room")
    assert [line.name for line in capture.lasers] == ["left", "right"]
    assert list(capture.laser) == [0, 1] * 10
    # The line of the second laser lies 40 px beside that of the first.
    for k in (0, 4):
        (on, off), (on_2, off_2) = capture.frames(k), capture.frames(k + 1)
        first, second = ((a.astype(int) - b).argmax(1) for a, b in ((on, off), (on_2, off_2)))
        assert abs(float((second - first).mean()) - 40.0) < 2.0


def test_with_one_laser_nothing_is_said_of_it(tmp_path):
    desk = Desk()
    desk.sweep(tmp_path / "room")
    assert all("lasers" not in one for one in records(tmp_path / "room"))


def test_a_dark_laser_is_found_though_the_other_shines(tmp_path):
    desk = Desk(laser=BOTH, checks={"retakes": 1})
    desk.table.dead_lasers = {2}
    with pytest.raises(FrameError, match=r"step 1: not proven in 2 takes.*the laser is dark"):
        desk.sweep(tmp_path / "room")
    # Noticed when the next one was taken, which is good.
    assert [(one["i"], one["lasers"]) for one in records(tmp_path / "room")] == [(0, ["left"]), (2, ["left"])]


def test_a_retake_is_of_the_laser_whose_pair_was_dropped(tmp_path):
    desk = Desk(laser=BOTH)
    desk.camera.faults[7] = "missing"
    lit = shots_of(desk)
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.retakes) == ("complete", 1)
    assert lit[:6] == [(0, 1), (1, 2), (2, 1), (3, 2), (3, 2), (4, 1)]


def test_a_sweep_that_ended_between_two_lasers_goes_on_with_the_other(tmp_path):
    desk = Desk(laser=BOTH)
    stopped = desk.sweep(tmp_path / "room", should_stop=After(5))
    assert (stopped.status, stopped.records) == ("interrupted", 5)
    again = Desk(laser=BOTH)
    lit = shots_of(again)
    result = again.sweep(tmp_path / "room", resume=True)
    assert (result.status, result.records, result.taken) == ("complete", 20, 15)
    # Record 4 is compared first, with its own laser.
    assert lit[:3] == [(4, 1), (5, 2), (6, 1)]
    assert [one["lasers"] for one in records(tmp_path / "room")] == [["left"], ["right"]] * 10


def test_boards_are_taken_with_each_laser(tmp_path):
    desk = Desk(laser=BOTH, board=BOARD, calibration=VIEWS)
    result = desk.calibrate(tmp_path / "boards", SimpleNamespace(place=lambda request: True))
    assert (result.status, result.records, result.planned) == ("complete", 10, 10)
    found = records(tmp_path / "boards")
    assert [one["lasers"] for one in found] == [["left"], ["right"]] * 5
    assert [one["placement"] for one in found] == [0, 0, 1, 1, 2, 2, 2, 2, 2, 2]
    assert [one["microsteps"] for one in found] == [0, 0, 0, 0, -800, -800, 0, 0, 800, 800]
    # Home is looked for where the table had turned, and not after a view from home.
    homes = [event["why"] for event in events(tmp_path / "boards", "home")]
    assert homes == ["start", "end of a placement"]


def test_the_plan_counts_the_frames_of_both():
    rig = rig_config(laser=BOTH, board=BOARD, calibration=VIEWS)
    targets, _ = plan_sweep(rig)
    assert [target.record for target in targets] == list(range(20))
    assert [rig.laser_of(target.record) for target in targets] == [0, 1] * 10
    assert estimate(rig, [target.position for target in targets]).frames == 40
    free, stands = placed_targets(rig, placement_positions(rig))
    assert [[target.record for target in one] for one in (*free, *stands)] == [[0, 1], [2, 3], [4, 5, 6, 7, 8, 9]]


def test_both_lasers_are_given_the_time_of_the_slower():
    settings = controller_settings(rig_config(laser=BOTH))
    assert (settings.laser_on_ms, settings.laser_off_ms, settings.lasers) == (35, 20, 2)


@pytest.mark.parametrize("trigger", ["software", "free"])
def test_a_camera_without_a_wire_sees_each_laser(tmp_path, trigger):
    desk = Desk(laser=BOTH, camera={"trigger": trigger})
    lit = []
    laser = desk.controller.laser
    desk.controller.laser = lambda on, ms=None, *, number=1: (
        lit.append(number if on else 0),
        laser(on, ms, number=number),
    )
    assert desk.sweep(tmp_path / "room").status == "complete"
    assert [one["lasers"] for one in records(tmp_path / "room")] == [["left"], ["right"]] * 10
    # Renewing a lease, for its own laser: never from one to the other without darkness between.
    assert not any({before, after} == {1, 2} for before, after in itertools.pairwise(lit))


class Wire:
    def __init__(self, lasers):
        self.fake = FakeController(lasers=lasers)
        self.controller = JxsController(self.fake, self.fake.clock)
        self.controller.hello()


@pytest.mark.parametrize(("number", "field"), [(1, ""), (2, " n=2")])
def test_only_the_second_laser_has_a_number_on_the_wire(number, field):
    wire = Wire(lasers=2)
    wire.controller.configure(Settings(lasers=number))
    wire.controller.enable(True)
    wire.controller.home(30000)
    wire.controller.arm(True)
    wire.controller.shot(80, 7, number=number)
    wire.controller.wait_shot(7)
    wire.controller.laser(True, number=number)
    assert f"SHOT to=80 id=7 m=3{field}" in wire.fake.carried_out
    assert f"LASER on=1 ms=1000{field}" in wire.fake.carried_out
    assert any(text.startswith("HAS") for text in wire.fake.carried_out) is (number == 2)


def test_a_firmware_for_one_laser_is_refused_in_one_line():
    wire = Wire(lasers=1)
    with pytest.raises(FirmwareError, match="found a firmware that switches 1 laser, needed one that switches 2"):
        wire.controller.configure(Settings(lasers=2))
    assert not any(text.startswith("SET") for text in wire.fake.carried_out)
