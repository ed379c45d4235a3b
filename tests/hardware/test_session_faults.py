"""The fault table at the level of a session: one test for each fault, on the simulated desk, named after the fault."""

import json
import threading

import numpy as np
import pytest
from scanrig.cameras.simulated import SyntheticScene
from scanrig.errors import CameraError, Fault, FrameError, LinkLost, RigFault
from scanrig.recording import AHEAD

from jaxscan.files.capture import open_capture, verify_capture

from .desk import Desk, events, journal


def require_whole(folder, desk, count=10):
    """Every record is there once, proven, at its angle, and shows the scene at that angle."""
    capture = open_capture(folder)
    assert [record.i for record in capture.records] == list(range(count))
    np.testing.assert_allclose(capture.angles, np.radians(np.arange(count) * 3.6), atol=1e-12)
    for k in range(count):
        on, off = capture.frames(k)
        true_on, true_off = desk.see(288.0 * k, True), desk.see(288.0 * k, False)
        for found, true in ((on, true_on), (off, true_off)):
            # Two drawings differ by noise of about 1.4 DN; another angle, or the other frame, by far more.
            assert np.abs(found.astype(int) - true.astype(int)).mean() < 3
    assert verify_capture(folder) == []
    assert not desk.table.laser and not desk.table.contactor


# Faults that a session recovers from by itself


PASSING = {
    "06 cable pulled": lambda controller: controller.lose_link(attempts=3),
    "07 controller reset": lambda controller: controller.reset(),
    # A suspended host finds the link watchdog's or the lease's fault; the same position is still good.
    "09 watchdog": lambda controller: controller.fall_into(Fault.LINK_LOST),
    "09 lease": lambda controller: controller.fall_into(Fault.LEASE_RAN_OUT),
    "17 camera not ready": lambda controller: controller.fall_into(Fault.CAMERA_NOT_READY),
}


@pytest.mark.parametrize("shot", [1, 4, 11])
@pytest.mark.parametrize("fault", PASSING)
def test_a_passing_fault_costs_no_record(tmp_path, fault, shot):
    desk = Desk()
    desk.controller.before_shot[shot] = PASSING[fault]
    assert desk.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room", desk)
    # The position is lost by a reset only.
    after = ["after a fault"] if fault == "07 controller reset" else []
    assert [event["why"] for event in events(tmp_path / "room", "home")] == ["start", *after, "end of a pass"]
    back = [event["same_boot"] for event in events(tmp_path / "room", "reconnected")]
    assert back == {"06 cable pulled": [True], "07 controller reset": [False]}.get(fault, [])
    assert desk.controller.settings is not None


# 6 cable pulled


def test_06_cable_pulled_for_good(tmp_path):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: controller.lose_link(attempts=1000)
    with pytest.raises(LinkLost, match=r"did not come back.*switch its supply off by hand"):
        desk.sweep(tmp_path / "room")
    assert len(open_capture(tmp_path / "room")) == 3
    end = journal(tmp_path / "room")[-1]
    assert (end["status"], end["laser_off"]) == ("failed", False)
    again = Desk()
    assert again.sweep(tmp_path / "room", resume=True).status == "complete"
    require_whole(tmp_path / "room", again)


def test_07_table_pushed_while_the_controller_was_off(tmp_path):
    desk = Desk()

    def push(controller):
        desk.table.position += 777
        controller.reset()

    desk.controller.before_shot[5] = push
    assert desk.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room", desk)
    assert events(tmp_path / "room", "home")[1]["was"] == -(777 + 288 * 3)


# 7 the controller is reset


def test_07_steps_lost_before_a_reset_are_found_by_the_last_record(tmp_path):
    """The counter that would have shown it is gone with the reset: the picture of the last step shows it."""
    desk = Desk()
    desk.controller.before_shot[3] = lambda controller: controller.lose_steps(400)
    desk.controller.before_shot[6] = lambda controller: controller.reset()
    result = desk.sweep(tmp_path / "room")
    assert result.status == "suspect" and result.suspect == ((0, 4),)
    again = Desk()
    result = again.sweep(tmp_path / "room", resume=True)
    assert result.status == "complete" and result.taken == 5
    require_whole(tmp_path / "room", again)


# 11 the e-stop


def test_11_estop_ends_the_session_and_is_never_resumed_by_itself(tmp_path):
    desk = Desk()

    def press(controller):
        controller.estop = True
        controller.fall_into(Fault.EMERGENCY_STOP)

    desk.controller.before_shot[5] = press
    result = desk.sweep(tmp_path / "room")
    assert result.status == "e-stop" and "release" in result.message and result.records == 4
    assert "clear" not in desk.controller.log and desk.controller.log.count("home") == 1
    assert journal(tmp_path / "room")[-1]["status"] == "e-stop"
    # Pressed still: it stays where it is. Released, and asked to by a person: it goes on.
    assert desk.sweep(tmp_path / "room", resume=True).status == "e-stop"
    desk.controller.estop = False
    assert desk.sweep(tmp_path / "room", resume=True).status == "complete"
    require_whole(tmp_path / "room", desk)


def test_12_home_not_found_ends_the_session(tmp_path):
    desk = Desk()
    desk.controller.home = lambda *a: desk.controller.fall_into(Fault.HOME_NOT_FOUND)
    with pytest.raises(RigFault, match="home switch"):
        desk.sweep(tmp_path / "room")
    assert not desk.table.contactor


# 13 lost steps


@pytest.mark.parametrize(("lost", "status"), [(2, "complete"), (-2, "complete"), (3, "suspect"), (-40, "suspect")])
def test_13_lost_steps_make_all_since_the_last_good_home_suspect(tmp_path, lost, status):
    desk = Desk(sweep={"steps": 5, "turn_deg": 18.0, "turns": 3})
    # In the second of three passes: shots 1-6 are the first with its closing one.
    desk.controller.before_shot[9] = lambda controller: controller.lose_steps(lost)
    result = desk.sweep(tmp_path / "room")
    assert result.status == status
    missed = [event.get("missed") for event in events(tmp_path / "room", "home")]
    assert missed == [None, 0, lost, 0]
    if status == "suspect":
        assert result.suspect == ((5, 9),) and "5 to 9" in result.message
        (event,) = events(tmp_path / "room", "suspect")
        assert event["records"] == [[5, 9]] and event["missed"] == lost
        again = Desk(sweep={"steps": 5, "turn_deg": 18.0, "turns": 3})
        repaired = again.sweep(tmp_path / "room", resume=True)
        assert (repaired.status, repaired.taken, repaired.suspect) == ("complete", 5, ())
        assert Desk(sweep=dict(again.config.sweep)).sweep(tmp_path / "room", resume=True).taken == 0


def lose_link_in(desk, method, call):
    """After the rig has done it the call-th time, the answer is lost."""
    do, count = getattr(desk.controller, method), []

    def done_unheard(*arguments):
        result = do(*arguments)
        count.append(1)
        if len(count) == call:
            desk.controller.lose_link()
            raise LinkLost("no answer from paper")
        return result

    setattr(desk.controller, method, done_unheard)


def reset_in_home(desk):
    """The controller starts anew while it looks for home at the end of the pass."""
    home = desk.controller.home

    def reset_once(*arguments):
        desk.controller.home = home
        desk.controller.reset()

    desk.controller.before_shot[11] = lambda controller: setattr(controller, "home", reset_once)


@pytest.mark.parametrize("when", ["home is not heard", "contactor is not heard", "reset"])
@pytest.mark.parametrize("lost", [0, 80, 3000])
def test_13_lost_steps_are_not_forgotten_where_homing_is_repeated(tmp_path, when, lost):
    """The second homing of a fault finds home at 0 in any case: that says nothing of the records before the first."""
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: controller.lose_steps(lost)
    if when == "home is not heard":
        lose_link_in(desk, "home", 2)
    elif when == "contactor is not heard":
        lose_link_in(desk, "arm", 2)
    else:
        reset_in_home(desk)
    result = desk.sweep(tmp_path / "room")
    assert desk.controller.log.count("home") >= 3
    if lost:
        assert (result.status, result.suspect) == ("suspect", ((0, 9),))
        again = Desk()
        assert again.sweep(tmp_path / "room", resume=True).taken == 10
        desk = again
    else:
        assert result.status == "complete"
    require_whole(tmp_path / "room", desk)


# 15 the laser


def test_15_dead_laser_stops_after_the_retakes(tmp_path):
    desk = Desk(checks={"retakes": 2})
    desk.controller.before_shot[4] = lambda controller: setattr(desk.table, "dead", True)
    with pytest.raises(FrameError, match=r"step 3: not proven in 3 takes.*laser is dark"):
        desk.sweep(tmp_path / "room")
    # Noticed when the next step was taken; from then on one at a time.
    assert desk.controller.shots == [0, 288, 576, 864, 1152, 864, 864]
    assert len(open_capture(tmp_path / "room")) == 3
    assert [event["step"] for event in events(tmp_path / "room", "retake")] == [3, 4, 3, 3]


def test_15_laser_that_stays_on_opens_the_contactor_and_says_so(tmp_path):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: setattr(desk.table, "welded", True)
    with pytest.raises(FrameError, match=r"laser stays on.*contactor has been opened"):
        desk.sweep(tmp_path / "room")
    assert not desk.table.shines and not desk.table.contactor
    # Before anything else was tried, not by the general way out.
    log = desk.controller.log
    assert log.index("arm 0") < log.index("make_safe")
    assert len(open_capture(tmp_path / "room")) == 3


def test_15_laser_that_flickers_once_costs_a_retake(tmp_path):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: setattr(desk.table, "dead", True)
    desk.controller.before_shot[5] = lambda controller: setattr(desk.table, "dead", False)
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.retakes) == ("complete", 1)
    assert desk.controller.shots[3:7] == [864, 1152, 864, 1440]
    record = next(line for line in journal(tmp_path / "room") if line.get("i") == 3)
    assert record["retakes"] == 1 and "dark" in record["rejected"][0]
    require_whole(tmp_path / "room", desk)


def test_15_laser_that_is_slow_to_go_out_is_found_at_the_eighth_place(tmp_path):
    desk = Desk()
    see = desk.see

    def slow(position, lit):
        dark, bright = see(position, False).astype(float), see(position, True).astype(float)
        glow = bright if lit else dark + 0.2 * np.maximum(bright - dark, 0.0)
        return np.rint(glow).clip(0, 255).astype(np.uint8)

    desk.see = slow
    with pytest.raises(FrameError, match=r"step 7: the laser stays on: .* last 8 places.*contactor has been opened"):
        desk.sweep(tmp_path / "room")
    assert not desk.table.shines and not desk.table.contactor
    assert len(open_capture(tmp_path / "room")) == 8


# 16 the camera


def test_16_camera_lost_is_opened_again_and_the_step_retaken(tmp_path):
    desk = Desk()
    desk.camera.faults[8] = "lost"  # The laser-off frame of step 3.
    desk.camera.reachable = False
    reopen, tries = desk.camera.reopen, []

    def reopened():
        tries.append(desk.clock.now())
        assert not desk.table.laser and not desk.table.contactor
        desk.camera.reachable = len(tries) >= 4
        reopen()

    desk.camera.reopen = reopened
    assert desk.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room", desk)
    pauses = np.diff(tries)
    assert len(tries) == 4 and np.all(np.diff(pauses) > 0)
    assert events(tmp_path / "room", "camera")[0]["reopened"] == 4


def test_16_camera_that_does_not_come_back(tmp_path):
    desk = Desk(checks={"camera_reopens": 3})
    desk.camera.faults[8] = "lost"
    desk.camera.reachable = False
    with pytest.raises(CameraError, match="did not come back in 3 tries"):
        desk.sweep(tmp_path / "room")
    assert len(open_capture(tmp_path / "room")) == 3 and not desk.table.contactor
    again = Desk()
    assert again.sweep(tmp_path / "room", resume=True).status == "complete"
    require_whole(tmp_path / "room", again)


@pytest.mark.parametrize("trigger", ["hardware", "software"])
def test_16_camera_that_is_silent_twice_is_opened_again_with_the_laser_off(tmp_path, trigger):
    """It answers, but its frames go to nobody, as those of a camera that a killed program left running."""
    desk = Desk(camera={"trigger": trigger})
    reopen, tries, silent = desk.camera.reopen, [], dict.fromkeys(range(7, 1000), "missing")
    desk.camera.faults = silent

    def reopened():
        tries.append(desk.camera.exposures)
        assert not desk.table.laser and not desk.table.contactor
        desk.camera.faults = {}
        reopen()

    desk.camera.reopen = reopened
    assert desk.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room", desk)
    assert len(tries) == 1 and len(events(tmp_path / "room", "retake")) == 2
    assert [event["reopened"] for event in events(tmp_path / "room", "camera")] == [1]
    assert "no frame came, twice in a row" in events(tmp_path / "room", "fault")[0]["problem"]


def test_16_camera_that_stays_silent_is_opened_again_a_bounded_number_of_times(tmp_path):
    desk = Desk(checks={"retakes": 6})
    desk.camera.faults = dict.fromkeys(range(7, 1000), "missing")
    with pytest.raises(FrameError, match=r"not proven in 7 takes; reason of the last: 0 of 2 frames came"):
        desk.sweep(tmp_path / "room")
    assert len(events(tmp_path / "room", "camera")) == 3
    assert len(open_capture(tmp_path / "room")) == 3 and not desk.table.contactor


# 17 frames


FRAME_FAULTS = ["missing", "duplicate", "incomplete", "stale", "swapped", "late"]
FIRST_FRAME_FAULTS = [(one, at) for one in FRAME_FAULTS for at in (1, 2) if (one, at) != ("stale", 1)]


# Both frames of a step in the middle, and of the first one: before its first frame there is no older one.
@pytest.mark.parametrize(
    ("fault", "exposure"),
    [
        *((one, at) for one in FRAME_FAULTS for at in (7, 8)),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in FIRST_FRAME_FAULTS),
    ],
)
def test_17_frame_fault_is_retaken_at_the_same_place(tmp_path, fault, exposure):
    desk = Desk()
    desk.camera.faults[exposure] = fault
    result = desk.sweep(tmp_path / "room")
    assert result.status == "complete"
    require_whole(tmp_path / "room", desk)
    # A laser-on frame that comes only with its laser-off frame is a good frame.
    harmless = fault == "late" and exposure % 2 == 1
    assert result.retakes >= (0 if harmless else 1)
    step = (exposure - 1) // 2
    shots = [at // 288 for at in desk.controller.shots]
    if fault in ("stale", "swapped") and not (fault == "swapped" and exposure % 2 == 0):
        # The frames are whole and their numbers right: only the proof tells, when the next step is taken.
        assert result.retakes == 1 and shots[step : step + 4] == [step, step + 1, step, step + 2]
    else:
        assert shots[step : step + 1 + result.retakes] == [step] * (1 + result.retakes)
    record = next(line for line in journal(tmp_path / "room") if line.get("i") == step)
    assert record["retakes"] == result.retakes


@pytest.mark.parametrize("fault", ["missing", "swapped"])
def test_17_frame_fault_that_does_not_end(tmp_path, fault):
    desk = Desk(checks={"retakes": 3})
    desk.camera.faults.update(dict.fromkeys(range(7, 100), fault))
    with pytest.raises(FrameError, match="step 3: not proven in 4 takes"):
        desk.sweep(tmp_path / "room")
    assert len(open_capture(tmp_path / "room")) == 3


def test_17_an_unexpected_trigger(tmp_path):
    desk = Desk()

    def noise(controller):
        controller.exposures = (controller.exposures + 1) % 65536

    wait = desk.controller.wait_shot

    def counted(*arguments):
        if len(desk.controller.shots) == 4:
            noise(desk.controller)
        return wait(*arguments)

    desk.controller.wait_shot = counted
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.retakes) == ("complete", 1)
    assert "counted 3 exposures" in events(tmp_path / "room", "retake")[0]["reason"]
    require_whole(tmp_path / "room", desk)


def test_17_a_frame_that_came_between_two_steps(tmp_path):
    """The numbers say that a frame was exposed and lost between two pairs: nothing is certain any more."""
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: (
        desk.camera.expose(0.0, False),
        desk.camera.drop(),
    )
    result = desk.sweep(tmp_path / "room")
    assert (result.status, result.retakes) == ("complete", 1)
    require_whole(tmp_path / "room", desk)


# 18 the camera's settings


def test_18_camera_comes_back_with_another_exposure(tmp_path):
    desk = Desk()
    desk.camera.faults[8] = "lost"
    desk.camera.after_reopen = {"exposure_s": 0.02}
    with pytest.raises(CameraError, match=r"exposure_s: found 0.02, expected 0.01"):
        desk.sweep(tmp_path / "room")
    assert len(open_capture(tmp_path / "room")) == 3


def test_18_frame_of_another_size(tmp_path):
    desk = Desk()
    see = desk.see
    desk.controller.before_shot[4] = lambda controller: setattr(desk, "see", lambda *where: see(*where)[:80])
    with pytest.raises(CameraError, match=r"found a frame of the shape \(80, 128\), expected \(96, 128\)"):
        desk.sweep(tmp_path / "room")


# 19 light


def test_19_light_that_changes_is_said_once(tmp_path):
    desk = Desk()
    bright = SyntheticScene(ambient_dn=100.0)
    desk.controller.before_shot[4] = lambda controller: setattr(desk, "scene", bright)
    result = desk.sweep(tmp_path / "room")
    assert result.status == "complete"
    (event,) = events(tmp_path / "room", "light")
    assert event["record"] == 3 and event["was_dn"] == pytest.approx(30, abs=5)
    assert event["is_dn"] == pytest.approx(100, abs=10)


def test_24_clock_that_jumps_back_by_a_year(tmp_path):
    desk = Desk()

    def jump(controller):
        desk.clock.start = desk.clock.start.replace(year=1999)

    desk.controller.before_shot[4] = jump
    assert desk.sweep(tmp_path / "room").status == "complete"
    records = [line for line in journal(tmp_path / "room") if "i" in line]
    assert {record["time"][:4] for record in records} == {"2000", "1999"}
    # Growing counters are stored beside it.
    assert np.all(np.diff([record["time_s"] for record in records]) > 0)
    require_whole(tmp_path / "room", desk)


# 24 clocks


# 25 a slow writer


def test_25_slow_disk_holds_the_table_and_loses_nothing(tmp_path, monkeypatch):
    """The disk writes a pair only when as many steps more were begun as may wait: no more ever do, and no fewer."""
    from jaxscan.files import recording

    original, desk, behind, shots = recording.write_atomically, Desk(), [], threading.Condition()

    def slow(path, content, **keys):
        if path.stem.isdigit():  # A frame, not the header.
            with shots:
                enough = min(int(path.stem) + 1 + AHEAD, 10)
                assert shots.wait_for(lambda: len(desk.controller.shots) >= enough, timeout=60)
        original(path, content, **keys)

    monkeypatch.setattr(recording, "write_atomically", slow)
    shot = desk.controller.shot

    def counting(to, id, **keys):
        lines = (tmp_path / "room" / "frames.jsonl").read_text().splitlines()
        behind.append(len(desk.controller.shots) - sum('"i"' in line for line in lines))
        assert not desk.table.laser
        with shots:
            shot(to, id, **keys)
            shots.notify_all()

    desk.controller.shot = counting
    assert desk.sweep(tmp_path / "room").status == "complete"
    # The closing shot comes when all are in the journal.
    assert max(behind) == AHEAD and behind[-1] == 0
    require_whole(tmp_path / "room", desk)


# 27 drift


def test_27_camera_that_was_knocked_is_said_at_the_end_of_the_pass(tmp_path):
    desk = Desk()
    desk.controller.before_shot[8] = lambda controller: setattr(desk.table, "moved_px", 5)
    result = desk.sweep(tmp_path / "room")
    (event,) = events(tmp_path / "room", "closing")
    assert event["good"] is False and event["shift_px"] == pytest.approx(5, abs=0.2)
    assert any("taken again, has changed" in sentence for sentence in desk.said)
    assert result.records == 10


@pytest.mark.parametrize("kept", ["home", "suspect"])
def test_13_a_session_that_is_killed_right_after_it_missed_home(tmp_path, kept):
    desk = Desk()
    desk.controller.before_shot[4] = lambda controller: controller.lose_steps(400)
    assert desk.sweep(tmp_path / "room").status == "suspect"
    path = tmp_path / "room" / "frames.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    end = max(k for k, line in enumerate(lines) if json.loads(line).get("event") == kept)
    path.write_text("".join(lines[: end + 1]))
    # The controller lives on: now it is at home, and says so.
    result = desk.sweep(tmp_path / "room", resume=True)
    assert (result.status, result.taken) == ("complete", 10)
    require_whole(tmp_path / "room", desk)
