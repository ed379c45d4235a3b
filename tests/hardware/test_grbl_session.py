"""Whole sweeps with a GRBL board: a session keeps its promises with it, and reports those that it cannot keep."""

import pytest
from scanrig.controllers import Settings, open_controller
from scanrig.doctor import examine
from scanrig.errors import ControllerReset, Fault, FirmwareError, LinkLost, Refused, RigFault
from scanrig.recording import AHEAD
from scanrig.session import Devices, Hooks, run_sweep

from jaxscan.errors import ConfigError
from jaxscan.files.capture import open_capture

from .desk import events, records
from .grbl_rig import GrblBoard, camera_of, open_board, rig_config


STEPS = 6


class GrblRig:
    """A board, and sessions with it."""

    def __init__(self, board, **config):
        self.board, self.said = board, []
        self.config = rig_config(steps=STEPS, **config)
        self.events = {}

    def sweep(self, folder, *, resume=False, **hooks):
        """A sweep; `self.events[n]()` is called after n pairs."""
        pairs = []

        def on_pair(*pair):
            pairs.append(pair)
            if act := self.events.pop(len(pairs), None):
                act()

        with open_board(self.board, self.config) as controller:
            camera = camera_of(self.board, self.config)
            called = Hooks(**{"on_pair": on_pair, "notify": self.said.append, **hooks})
            return run_sweep(self.config, folder, Devices(controller, camera, self.board.clock), called, resume=resume)


@pytest.fixture
def board():
    return GrblBoard()


@pytest.fixture
def rig(board):
    return GrblRig(board)


def require_whole(folder):
    """Every record is there, at its place, with the laser in the one image and not in the other."""
    found = {line["i"]: line for line in records(folder)}
    assert sorted(found) == list(range(STEPS))
    capture = open_capture(folder)
    for chunk in capture.chunks(STEPS):
        for number, (on, off) in enumerate(zip(chunk.on, chunk.off, strict=True)):
            assert found[number]["microsteps"] == 80 * number
            contrast = on.astype(int) - off
            assert contrast.max() > 50 and (contrast.max(1) > 20).mean() > 0.5


def test_a_sweep_is_whole_and_ends_dark(rig, tmp_path):
    result = rig.sweep(tmp_path / "room")
    assert (result.status, result.retakes, result.laser_off) == ("complete", 0, True)
    require_whole(tmp_path / "room")
    assert not rig.board.lit
    # A pair each, the last record or the first compared again, and each time off again.
    lights = [value for _, kind, value in rig.board.ledger if kind == "light"]
    assert lights.count(1.0) == lights.count(0.0) >= STEPS + 1
    assert any("laser stays on" in sentence for sentence in rig.said)
    header = (tmp_path / "room" / "capture.toml").read_text()
    assert 'protocol = "Grbl"' in header and 'firmware = "1.1h"' in header


def test_it_is_refused_where_it_is_not_allowed(board, tmp_path):
    config = rig_config(steps=STEPS, allow_laser_without_watchdog=False)
    with pytest.raises(ConfigError, match="write allow_laser_without_watchdog = true under") as refused:
        open_controller(config.controller, config.microsteps_per_turn)
    assert "\n" not in str(refused.value)
    # And by a session, with a controller that was opened elsewhere.
    with pytest.raises(ConfigError, match="allow_laser"):
        GrblRig(board, allow_laser_without_watchdog=False).sweep(tmp_path / "room")
    assert not (tmp_path / "room").exists() and not board.lit


def test_the_doctor_says_what_the_board_cannot(rig, tmp_path):
    found = {}
    with open_board(rig.board, rig.config) as controller:
        camera = camera_of(rig.board, rig.config)
        examine(
            controller,
            camera,
            rig.config,
            folder=tmp_path,
            tell=lambda finding: found.update({finding.name: finding}),
            clock=rig.board.clock,
        )
    verdicts = {name: finding.verdict for name, finding in found.items()}
    assert "wrong" not in verdicts.values(), found
    assert verdicts["safety"] == "note" and "the laser stays on" in found["safety"].found
    assert verdicts["steps per turn"] == "not checked"
    assert (verdicts["home"], verdicts["laser"], verdicts["laser off"]) == ("works", "works", "works")
    assert not rig.board.lit


def test_a_board_that_is_set_otherwise_is_refused_with_what_to_type(rig, tmp_path):
    rig.board.settings |= {100: 250.0, 32: 1.0}
    with pytest.raises(FirmwareError, match=r"found \$32=1\.0, \$100=250\.0; expected \$32=0, \$100=80: type that"):
        rig.sweep(tmp_path / "room")
    assert not rig.board.lit


def test_without_a_home_switch_home_is_where_the_table_stands():
    board = GrblBoard(s22=0.0)
    with open_board(board, rig_config(grbl={"home": ""})) as controller:
        controller.hello()
        controller.enable(True)
        stood = board.position
        assert controller.home(40000) is None and board.position == stood
        assert controller.move(160) == 160 and board.position == pytest.approx(stood + 2.0)
        assert controller.home(40000) is None and board.position == pytest.approx(stood)
        board.power_cycle()
        with pytest.raises(ControllerReset):
            for _ in range(5):
                controller.poll()
        assert not controller.reconnect().status.homed
        with pytest.raises(Refused, match="not known any more"):
            controller.home(40000)


def test_a_camera_that_waits_for_a_wire_is_refused(board, tmp_path):
    rig = GrblRig(board)
    wired = {"camera": rig.config.camera.model_copy(update={"trigger": "hardware"})}
    rig.config = rig.config.model_copy(update=wired)
    with pytest.raises(ConfigError, match="has no wire to the camera"):
        rig.sweep(tmp_path / "room")
    assert board.heard == [] or not board.lit


def test_a_pulled_cable_is_recovered_from(rig, tmp_path):
    def pull():
        rig.board.unplug()
        rig.board.later(0.5, rig.board.plug)

    rig.events[2] = pull
    assert rig.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room")
    assert [event["same_boot"] for event in events(tmp_path / "room", "reconnected")] == [True]
    assert not rig.board.lit


def test_a_cable_that_stays_away_ends_the_session_loudly(rig, tmp_path):
    rig.events[2] = rig.board.unplug
    with pytest.raises(LinkLost, match=r"did not come back.*switch its supply off by hand"):
        rig.sweep(tmp_path / "room")
    # And those that were in flight then.
    assert 2 <= len(records(tmp_path / "room")) <= 2 + AHEAD


def test_a_reset_is_recovered_from(rig, tmp_path):
    rig.events[3] = rig.board.power_cycle
    assert rig.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room")
    assert [event["same_boot"] for event in events(tmp_path / "room", "reconnected")] == [False]
    assert rig.board.heard.count("$H") >= 3 and not rig.board.lit


def test_a_reset_while_the_table_turns_is_recovered_from(rig, tmp_path):
    rig.events[3] = lambda: rig.board.later(0.03, rig.board.power_cycle)
    assert rig.sweep(tmp_path / "room").status == "complete"
    require_whole(tmp_path / "room")


def test_an_alarm_ends_the_session_by_name(rig, tmp_path):
    rig.events[3] = rig.board.hit_limit
    with pytest.raises(RigFault, match=r"a limit switch was hit.*ALARM:1") as alarm:
        rig.sweep(tmp_path / "room")
    assert alarm.value.fault is Fault.LIMIT and not rig.board.lit
    assert rig.sweep(tmp_path / "room", resume=True).status == "complete"
    require_whole(tmp_path / "room")


def test_steps_lost_on_the_way_show_in_the_pictures(rig, tmp_path):
    """The board says nothing of it at home; the first step of the turn, taken again, does."""

    def slip():
        rig.board.slipped = 10.0

    rig.events[2] = slip
    result = rig.sweep(tmp_path / "room")
    assert any("taken again, has changed" in sentence for sentence in rig.said) or result.status == "suspect"


def test_the_laser_is_off_after_an_interrupt(rig, tmp_path):
    def interrupt():
        raise KeyboardInterrupt

    rig.events[2] = interrupt
    with pytest.raises(KeyboardInterrupt):
        rig.sweep(tmp_path / "room")
    assert not rig.board.lit


def test_noise_on_the_line_leaves_nothing_out(rig, tmp_path):
    count = [0]

    def garble(data):
        count[0] += 1
        return data.replace(b"ok", b"o~") if count[0] % 9 == 0 else data

    rig.board.to_host = garble
    result = rig.sweep(tmp_path / "room")
    assert result.status == "complete"
    require_whole(tmp_path / "room")
    assert events(tmp_path / "room", "end")[0]["link"]["resent"] > 2


def test_an_abandoned_host_leaves_the_laser_on_and_the_next_session_puts_it_off(board):
    """The configuration has to allow that: nobody is there any more who could switch it off."""
    controller = open_board(board, rig_config())
    controller.hello()
    controller.configure(Settings(speed=8000))
    controller.enable(True)
    controller.home(40000)
    controller.arm(True)
    controller.laser(True)
    board.clock.sleep(3600.0)
    assert board.lit
    with open_board(board, rig_config()) as controller:
        controller.hello()
        assert not board.lit
