"""A calibration on the simulated desk: free views, placements, and resuming half done ones."""

import numpy as np
import pytest
from scanrig.errors import CameraLost, CameraTimeout, Fault, LinkLost

from jaxscan.files.capture import open_capture, verify_capture

from .desk import Desk, events


BOARD = {"type": "charuco", "columns": 12, "rows": 9, "square_mm": 30.0, "marker_mm": 22.0}
PLAN = {"free_views": 3, "placements": 2, "angles_deg": [-10.0, 0.0, 10.0]}


class Operator:
    """Places the board a given number of times of each kind, and records the requests."""

    def __init__(self, desk, free=99, placements=99):
        self.desk, self.asked, self.lit = desk, [], []
        self.left = {"free": free, "placement": placements}

    def place(self, request):
        self.asked.append((request.kind, request.number, request.total))
        self.lit.append(self.desk.table.laser or self.desk.table.contactor)
        self.left[request.kind] -= 1
        return self.left[request.kind] >= 0


def make(**tables):
    return Desk(board=BOARD, calibration=PLAN, **tables)


def records(path):
    """Number, angle and placement of each record."""
    capture = open_capture(path)
    return [(one.i, round(float(np.degrees(one.angle)), 6), one.placement) for one in capture.records]


WHOLE = [
    (0, 0.0, 0),
    (1, 0.0, 1),
    (2, 0.0, 2),
    (3, -10.0, 3),
    (4, 0.0, 3),
    (5, 10.0, 3),
    (6, -10.0, 4),
    (7, 0.0, 4),
    (8, 10.0, 4),
]


def test_free_views_from_home_then_placements_at_all_angles(tmp_path):
    desk = make()
    operator = Operator(desk)
    result = desk.calibrate(tmp_path / "boards", operator, advise=lambda: ["Tilt it."])
    assert (result.status, result.records, result.planned) == ("complete", 9, 9)
    assert records(tmp_path / "boards") == WHOLE
    assert operator.asked == [("free", k, 3) for k in range(3)] + [("placement", k, 2) for k in range(2)]
    # Whoever stands at the board stands in front of an open contactor.
    assert operator.lit == [False] * 5
    capture = open_capture(tmp_path / "boards")
    assert capture.header.kind == "calibration" and capture.board is not None
    for k in range(9):
        on, off = capture.frames(k)
        assert on.astype(int).max() - off.astype(int).max() > 50
    assert verify_capture(tmp_path / "boards") == []
    homes = [event["why"] for event in events(tmp_path / "boards", "home")]
    assert homes == ["start", "end of a placement", "end of a placement"]


def test_the_table_points_to_where_the_board_is_to_stand(tmp_path):
    desk = Desk(board=BOARD, calibration=PLAN | {"bearings_deg": [0.0, 90.0]})
    operator, stood = Operator(desk), []
    place = operator.place
    operator.place = lambda request: (stood.append((request.at_deg, desk.table.position)), place(request))[1]
    result = desk.calibrate(tmp_path / "boards", operator)
    quarter = desk.config.microsteps_per_turn // 4
    assert stood == 4 * [(0.0, 0)] + [(90.0, quarter)]
    # Not while operator is near it.
    assert operator.lit == [False] * 5
    assert (result.status, result.records) == ("complete", 9)
    angles = [angle for _, angle, _ in records(tmp_path / "boards")]
    assert angles == [0.0] * 3 + [-10.0, 0.0, 10.0] + [80.0, 90.0, 100.0]


def test_the_operator_may_have_enough(tmp_path):
    desk = make()
    result = desk.calibrate(tmp_path / "boards", Operator(desk, free=1, placements=1))
    assert (result.status, result.records) == ("complete", 4)
    assert [placement for *_, placement in records(tmp_path / "boards")] == [0, 1, 1, 1]


def test_enough_of_nothing_is_no_calibration(tmp_path):
    desk = make()
    result = desk.calibrate(tmp_path / "boards", Operator(desk, free=0, placements=0))
    assert (result.status, result.records) == ("interrupted", 0)
    assert "0 of 9 records" in result.message and "can be resumed" in result.message
    again = make()
    assert again.calibrate(tmp_path / "boards", Operator(again), resume=True).records == 9


def test_a_placement_that_was_half_done_is_begun_anew_under_another_number(tmp_path):
    desk = make()
    desk.controller.before_shot[8] = lambda controller: controller.lose_link(attempts=1000)
    with pytest.raises(LinkLost):
        desk.calibrate(tmp_path / "boards", Operator(desk))
    assert records(tmp_path / "boards") == WHOLE[:7]
    again = make()
    operator = Operator(again)
    result = again.calibrate(tmp_path / "boards", operator, resume=True)
    assert (result.status, result.records, result.taken) == ("complete", 9, 3)
    assert operator.asked == [("placement", 1, 2)]
    # The three of the second placement saw one board that did not move: a new number for all of them.
    assert records(tmp_path / "boards")[:6] == WHOLE[:6]
    assert records(tmp_path / "boards")[6:] == [(6, -10.0, 5), (7, 0.0, 5), (8, 10.0, 5)]
    assert verify_capture(tmp_path / "boards") == []


def test_a_complete_calibration_asks_for_nothing(tmp_path):
    desk = make()
    desk.calibrate(tmp_path / "boards", Operator(desk))
    again = make()
    operator = Operator(again)
    assert again.calibrate(tmp_path / "boards", operator, resume=True).taken == 0
    assert operator.asked == [] and again.controller.log == []


def test_steps_lost_during_a_placement_make_it_suspect_and_it_alone(tmp_path):
    desk = make()
    desk.controller.before_shot[5] = lambda controller: controller.lose_steps(30)
    result = desk.calibrate(tmp_path / "boards", Operator(desk))
    # Free views stand at home like all since the last time home was found; they are in doubt as well.
    assert result.status == "suspect" and result.suspect == ((0, 5),)
    again = make()
    operator = Operator(again)
    result = again.calibrate(tmp_path / "boards", operator, resume=True)
    assert (result.status, result.suspect) == ("complete", ())
    assert operator.asked == [("free", k, 3) for k in range(3)] + [("placement", 0, 2)]


class LookingOperator(Operator):
    """Looks through the camera before the board is taken to be placed; `faults[n]` happens in the n-th look."""

    def __init__(self, desk, **faults):
        super().__init__(desk)
        self.faults = {int(name.removeprefix("look")): fault for name, fault in faults.items()}
        self.looks, self.contactor = [], []
        self._arm = desk.controller.arm
        desk.controller.trigger, desk.controller.arm = self.trigger, self.arm

    def trigger(self):
        controller = self.desk.controller
        controller.stat()
        self.looks.append(1)
        exposed = self.faults.get(len(self.looks), lambda controller: None)(controller)
        controller.stat()
        controller.exposures = (controller.exposures + 1) % 65536
        if exposed is None:
            controller.camera.expose(self.desk.table.position, self.desk.table.shines)

    def arm(self, on):
        self.contactor.append((on, len(self.asked), self.at_the_board))
        self._arm(on)

    at_the_board = False

    def place(self, request):
        self.at_the_board = True
        image = request.look()
        assert image.shape == (96, 128) and image.max() < 100
        self.at_the_board = False
        return super().place(request)


def lost_camera(controller):
    raise CameraLost("SIM1 went away")


@pytest.mark.parametrize(
    "faults",
    [
        lambda controller: "no frame",
        lambda controller: controller.lose_link(2),
        lambda controller: controller.reset(),
        lambda controller: controller.fall_into(Fault.LINK_LOST),
        lost_camera,
    ],
    ids=["lost frame", "lost link", "reset", "fault", "lost camera"],
)
def test_a_fault_while_the_operator_looks_through_the_camera_ends_nothing(tmp_path, faults):
    desk = make()
    operator = LookingOperator(desk, look2=faults)
    result = desk.calibrate(tmp_path / "boards", operator)
    assert (result.status, result.records, len(operator.looks)) == ("complete", 9, 6)
    # Nothing that had to be recovered from has closed the contactor in front of whoever stands there.
    assert operator.lit == [False] * 5
    assert not any(on and at_the_board for on, _, at_the_board in operator.contactor)
    assert verify_capture(tmp_path / "boards") == []


def test_a_link_that_is_lost_twice_while_the_camera_is_reopened_for_a_look_ends_nothing(tmp_path):
    desk = make()
    controller = desk.controller
    reopen, reconnect, lost = desk.camera.reopen, controller.reconnect, []

    def losing(original):
        def call(*given):
            answer = original(*given)
            if len(lost) < 2:
                lost.append(original.__name__)
                controller.lose_link(1)
            return answer

        return call

    desk.camera.reopen, controller.reconnect = losing(reopen), losing(reconnect)
    operator = LookingOperator(desk, **{f"look{k}": lambda controller: "no frame" for k in (2, 3)})
    result = desk.calibrate(tmp_path / "boards", operator)
    assert lost == ["reopen", "reconnect"]
    assert (result.status, result.records) == ("complete", 9)
    assert operator.lit == [False] * 5


def test_a_camera_that_shows_nothing_any_more_is_an_error(tmp_path):
    desk = make(checks={"retakes": 2})
    operator = LookingOperator(desk, **{f"look{k}": lambda controller: "no frame" for k in (2, 3, 4)})
    with pytest.raises(CameraTimeout):
        desk.calibrate(tmp_path / "boards", operator)
    assert len(operator.looks) == 4 and not desk.table.contactor


def test_asked_to_stop_while_the_board_is_moved(tmp_path):
    desk = make()
    operator = Operator(desk)
    result = desk.calibrate(tmp_path / "boards", operator, should_stop=lambda: len(operator.asked) >= 2)
    assert (result.status, result.records) == ("interrupted", 1)
    again = make()
    assert again.calibrate(tmp_path / "boards", Operator(again), resume=True).records == 9
    assert len(open_capture(tmp_path / "boards")) == 9


def test_without_a_board_it_is_refused_before_anything_moves(tmp_path):
    desk = Desk(calibration=PLAN)
    with pytest.raises(Exception, match=r"\[board\]"):
        desk.calibrate(tmp_path / "boards", Operator(desk))
    assert desk.controller.log == [] and not (tmp_path / "boards").exists()
