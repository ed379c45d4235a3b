"""The doctor's findings on rigs with one fault each; it leaves every rig dark."""

import numpy as np
import pytest
from scanrig.cameras.simulated import SyntheticScene
from scanrig.doctor import examine, fitting_gear, measure_turn, stripe_level
from scanrig.errors import Fault, FirmwareError, LinkLost, RigError, RigFault

from .desk import Desk


@pytest.fixture
def desk():
    return make_desk()


def make_desk(**tables):
    desk = Desk(**tables)
    desk.controller.turn = 28800
    return desk


def examined(desk, tmp_path, **parts):
    found = {}
    try:
        examine(
            parts.get("controller", desk.controller),
            parts.get("camera", desk.camera),
            parts.get("config", desk.config),
            folder=tmp_path,
            tell=lambda finding: found.update({finding.name: finding}),
            clock=desk.clock,
        )
    finally:
        if parts.get("controller", desk.controller) is not None:
            assert not desk.table.laser and not desk.table.contactor
    return found


def test_a_rig_that_is_well(desk, tmp_path):
    found = examined(desk, tmp_path)
    said = {name: finding.verdict for name, finding in found.items()}
    # The synthetic line is 120 DN above a wall of 30: less than a scan could have.
    assert said.pop("exposure") == "note"
    table, light = ["firmware", "inputs", "settings", "home", "steps per turn"], ["camera", "trigger", "laser"]
    assert set(said) == {*table, *light, "laser off", "storage"}
    assert set(said.values()) == {"works"}, found
    assert found["steps per turn"].values == {"measured_microsteps": 28800, "expected_microsteps": 28800}
    assert found["trigger"].found == "6 pulses of the controller gave 6 frames, 6 of them complete"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("true", [28800, 28803, 9600, 14400, 7200, 5760, 16000, 57600, 86400, 3200])
def test_a_turn_is_measured_whatever_it_should_have_been(desk, true):
    controller = desk.controller
    controller.turn = true
    controller.hello()
    controller.enable(True)
    controller.home(60 * true)
    before = desk.table.position
    assert measure_turn(controller, 28800, speed=4000) == true
    # No cable is wound up: it came back by as many turns as it went.
    assert desk.table.position == before


def test_a_table_that_does_not_turn(desk):
    controller = desk.controller
    controller.turn = 10**9
    controller.table.position = 0
    controller.hello()
    controller.enable(True)
    with pytest.raises(RigError, match="did not come again"):
        measure_turn(controller, 3200, speed=4000)


def test_a_belt_that_slips(desk):
    desk.controller.table.position = 0
    desk.controller.slips = 700
    desk.controller.hello()
    desk.controller.enable(True)
    with pytest.raises(RigError, match="on the way back"):
        measure_turn(desk.controller, 28800, speed=4000)


@pytest.mark.parametrize(
    "turn, gear", [(28800, (9, 1)), (28797, (9, 1)), (12000, (15, 4)), (3200, (1, 1)), (16000, (5, 1)), (9601, (3, 1))]
)
def test_the_simplest_gear_that_fits(turn, gear):
    assert fitting_gear(turn, 3200) == gear


def test_no_gear_fits_a_turn_of_nothing():
    assert fitting_gear(1, 3_000_000) is None


@pytest.mark.parametrize(
    "true, cure",
    [
        (16000, "under [turntable] set gear = [5, 1]"),
        (14400, "under [turntable] set gear = [9, 2], or microsteps = 8, if the driver is set so"),
    ],
)
def test_another_gear_than_configured_is_named(desk, tmp_path, true, cure):
    desk.controller.turn = true
    found = examined(desk, tmp_path)
    assert found["steps per turn"].verdict == "wrong"
    assert found["steps per turn"].found == f"{true} microsteps from home to home, expected 28800"
    assert found["steps per turn"].do == cure
    # The rest can be looked at all the same.
    assert found["laser"].verdict == "works"


def test_limits_forbid_a_whole_turn(tmp_path):
    desk = make_desk(turntable={"limits_deg": [-10.0, 170.0]})
    found = examined(desk, tmp_path)
    assert found["steps per turn"].verdict == "not checked" and "by hand" in found["steps per turn"].do
    assert found["home"].verdict == "works"


@pytest.mark.parametrize("true, verdict", [(28800, "works"), (14400, "wrong"), (40000, "wrong")])
def test_within_limits_that_allow_a_turn_it_is_measured(tmp_path, true, verdict):
    desk = make_desk(turntable={"limits_deg": [-20.0, 370.0], "home_within_deg": 600.0})
    desk.controller.turn = true
    move, stood = desk.controller.move, []

    def moved(to, timeout_s=120.0):
        reached = move(to, timeout_s)
        stood.append(desk.table.position)
        return reached

    desk.controller.move = moved
    found = examined(desk, tmp_path)
    assert found["steps per turn"].verdict == verdict, found
    # Limits protect cables: from the first home, the table never left them, and they are set again.
    assert 0 <= min(stood) and max(stood) <= 370 * 80
    assert desk.controller.settings.limits == (-1600, 29600)


def test_estop_pressed(desk, tmp_path):
    desk.controller.fake.press(True)
    found = examined(desk, tmp_path)
    assert (found["inputs"].verdict, found["inputs"].found) == ("wrong", "the emergency stop is pressed")
    assert "home" not in found and desk.controller.shots == []


def test_home_switch_that_never_closes(desk, tmp_path):
    desk.controller.switch = False
    found = examined(desk, tmp_path)
    assert found["home"].verdict == "wrong" and "turntable.reverse" in found["home"].do
    assert "steps per turn" not in found and "laser" not in found
    # The trigger needs no home.
    assert found["trigger"].verdict == "works"


def slipping(desk):
    move, slipped = desk.controller.move, iter([0, 30, *[0] * 20])

    def moved(to, timeout_s=120.0):
        done = move(to, timeout_s)
        desk.table.position -= next(slipped)
        return done

    desk.controller.move = moved


@pytest.mark.parametrize(
    ("spoil", "name", "says", "unseen"),
    [
        (slipping, "home", "again +0 and +30 microsteps", {"laser"}),
        (lambda desk: setattr(desk.table, "dead", True), "laser", "the laser is dark", {"exposure"}),
        (lambda desk: setattr(desk.table, "welded", True), "laser", "the laser stays on", {"exposure"}),
        (lambda desk: setattr(desk.controller, "broken_wire", True), "trigger", "check the wire", set()),
        (lambda desk: setattr(desk.controller, "twice", True), "trigger", "gave 12 frames", set()),
    ],
)
def test_one_fault_is_named(desk, tmp_path, spoil, name, says, unseen):
    spoil(desk)
    found = examined(desk, tmp_path)
    assert found[name].verdict == "wrong" and says in f"{found[name].found}; {found[name].do}"
    assert unseen.isdisjoint(found)


def test_a_folder_that_cannot_be_written(desk, tmp_path):
    (tmp_path / "file").touch()
    found = examined(desk, tmp_path / "file")
    assert found["storage"].verdict == "wrong" and "cannot be written" in found["storage"].do


def test_pulses_that_are_longer_than_the_link_watchdog_waits(tmp_path):
    desk = make_desk(camera={"exposure_ms": 2000.0})
    found = examined(desk, tmp_path)
    assert found["trigger"].verdict == "works", found["trigger"]


def test_frames_in_part(desk, tmp_path):
    desk.camera.faults[2] = "incomplete"
    found = examined(desk, tmp_path)
    assert found["trigger"].verdict == "wrong" and "packet_size" in found["trigger"].do


@pytest.mark.parametrize("peak, longer", [(20.0, True), (60.0, True), (190.0, None), (900.0, False)])
def test_exposure(tmp_path, peak, longer):
    bright = make_desk(scene=SyntheticScene(peak_dn=90.0, ambient_dn=120.0, contrast=0.1))
    assert "darken the room" in examined(bright, tmp_path)["exposure"].do
    desk = make_desk(scene=SyntheticScene(peak_dn=peak))
    finding = examined(desk, tmp_path)["exposure"]
    if longer is None:
        assert finding.verdict == "works", finding
        return
    assert finding.verdict == "note" and finding.do.startswith("expose longer" if longer else "expose shorter")
    # With the proposed exposure: ten percent of the lines' pixels vary with the wall under them.
    factor = finding.values["factor"]
    proposed = 10.0 * factor
    assert f"camera.exposure_ms = {proposed:.3g} instead of 10" in finding.do
    if longer:
        brighter = make_desk(scene=SyntheticScene(peak_dn=peak * factor, ambient_dn=30.0 * factor))
        level, _ = stripe_level(brighter.see(0.0, True), brighter.see(0.0, False), desk.config)
        assert level == pytest.approx(225.0, rel=0.1)


def test_without_camera_the_controller_is_examined(desk, tmp_path):
    found = examined(desk, tmp_path, camera=None, config=None)
    assert set(found) == {"firmware", "inputs", "settings", "home", "steps per turn", "laser off"}
    assert found["steps per turn"].found == "28800 microsteps from home to home"
    assert desk.controller.fake.pulses == 0


def test_without_controller_the_camera_is_examined(desk, tmp_path):
    found = examined(desk, tmp_path, controller=None)
    assert {name: finding.verdict for name, finding in found.items()} == {
        "camera": "works", "trigger": "not checked", "storage": "works",
    }  # fmt: skip


@pytest.mark.parametrize(
    "problem", [KeyboardInterrupt(), RigFault(Fault.EMERGENCY_STOP, 0), LinkLost("gone"), ValueError("a mistake")]
)
@pytest.mark.parametrize("when", ["home", "laser", "trigger"])
def test_the_laser_is_off_on_every_way_out(desk, tmp_path, problem, when):
    controller = desk.controller

    def fails(*args, **options):
        controller.table.laser = controller.table.contactor = True
        raise problem

    setattr(controller, {"home": "home", "laser": "shot", "trigger": "trigger"}[when], fails)
    try:
        found = examined(desk, tmp_path)
    except (KeyboardInterrupt, ValueError) as raised:
        assert raised is problem
    else:
        assert found["laser off"].verdict == "works"
        assert "wrong" in {finding.verdict for finding in found.values()}
    assert not desk.table.laser and not desk.table.contactor


def test_levels_of_the_line():
    desk = make_desk()
    on, off = np.full((96, 128), 30, np.uint8), np.full((96, 128), 30, np.uint8)
    assert stripe_level(on, off, desk.config) == (0.0, 0.0)
    on[:, 60] = 130
    on[:48, 60] = 255
    level, clipped = stripe_level(on, off, desk.config)
    assert (level, clipped) == (255.0, 0.5)


@pytest.mark.parametrize("problem", [None, LinkLost("gone"), FirmwareError("the controller's answer lacks 'st'")])
def test_a_laser_that_is_not_confirmed_off_is_a_finding(desk, tmp_path, problem):
    def unsafe():
        if problem is not None:
            raise problem
        return False

    desk.controller.make_safe = unsafe
    found = {}
    examine(desk.controller, None, None, folder=tmp_path, tell=lambda f: found.update({f.name: f}), clock=desk.clock)
    assert found["laser off"].verdict == "wrong" and "by hand" in found["laser off"].do
