"""One step: the commands sent, the renewed lease, and the frames accepted."""

import dataclasses
import threading
import time
from itertools import count

import numpy as np
import pytest
from scanrig.cameras.simulated import FrameShape, SimulatedCamera, SyntheticScene, draw
from scanrig.controllers.jxs.controller import connect
from scanrig.errors import Fault, FrameError, RigFault
from scanrig.session import Devices, Hooks, run_sweep
from scanrig.session.plan import controller_settings
from scanrig.session.steps import Station

from .desk import HEIGHT, WIDTH, Desk, rig_config
from .scanning import Wire


def ready(desk):
    controller = desk.controller
    controller.hello()
    controller.configure(controller_settings(desk.config))
    controller.enable(True)
    controller.home(30000)
    controller.arm(True)
    desk.camera.start()


def take(desk, **keys):
    """A pair at microstep 80, and its proof."""
    return Station(desk.config, desk.controller, desk.camera, desk.clock, **keys).take(80, 1)


def test_frames_are_matched_over_the_counters_wrap():
    desk = Desk()
    ready(desk)
    desk.controller.exposures = 65535
    pair, _ = take(desk)
    assert desk.controller.exposures % 65536 == 1 and pair.rejections.reasons == () and pair.position == 80


def test_what_waits_from_before_is_dropped_and_not_taken_for_a_frame_of_this_step():
    desk = Desk()
    ready(desk)
    desk.camera.expose(0.0, True)
    desk.camera.expose(0.0, False)
    station = Station(desk.config, desk.controller, desk.camera, desk.clock, next_number=1)
    pair, _ = station.take(80, 1)
    assert (pair.on.number, pair.off.number, pair.rejections.reasons, station.next_number) == (3, 4, (), 5)


def test_a_camera_without_numbers_is_accepted_by_count_and_proof():
    desk = Desk()
    ready(desk)
    following = desk.camera.next
    desk.camera.next = lambda timeout_s: dataclasses.replace(following(timeout_s), number=-1)
    assert take(desk)[0].rejections.reasons == ()


def test_every_rejection_is_reported_and_the_last_one_raised():
    desk = Desk(checks={"retakes": 1})
    ready(desk)
    desk.table.dead = True
    reasons = []
    with pytest.raises(FrameError, match="step 1: not proven in 2 takes"):
        take(desk, rejected=lambda record, reason: reasons.append(reason))
    assert len(reasons) == 2 and all("dark" in reason for reason in reasons)


@pytest.mark.parametrize("trigger", ["software", "free"])
def test_the_laser_is_off_after_a_step_from_here_that_went_wrong(trigger):
    desk = Desk(camera={"trigger": trigger}, checks={"retakes": 0})
    ready(desk)
    desk.camera.faults[1] = "lost"
    with pytest.raises(Exception, match="gone"):
        take(desk)
    assert not desk.table.laser


@pytest.mark.parametrize("trigger", ["hardware", "software", "free"])
def test_a_session_that_was_silent_for_long_closes_the_contactor_again_once(trigger):
    desk = Desk(camera={"trigger": trigger})
    ready(desk)
    desk.controller.log.clear()
    assert take(desk)[0].rejections.reasons == () and "arm 1" not in desk.controller.log
    desk.clock.sleep(12.0)
    pair, proof = take(desk)
    assert pair.rejections.reasons == () and proof.ok
    assert desk.controller.log.count("arm 1") == 1


def test_a_contactor_that_a_fault_opened_is_not_closed_by_a_step():
    desk = Desk()
    ready(desk)
    with pytest.raises(RigFault):
        desk.controller.fall_into(Fault.EMERGENCY_STOP)
    desk.controller.log.clear()
    with pytest.raises(RigFault):
        take(desk)
    assert "arm 1" not in desk.controller.log and not desk.table.contactor


@pytest.mark.parametrize("trigger", ["hardware", "software"])
def test_a_session_that_was_silent_for_long_goes_on_with_real_firmware(rig, tmp_path, trigger):
    """Twelve simulated seconds of silence after the first pair, as of a slow disk: open, no fault, closed again."""
    simulated = rig(speed=1)
    config = rig_config(camera={"trigger": trigger}, sweep={"steps": 2, "turn_deg": 1.0})
    generator = np.random.default_rng(0)

    def see(position, lit):
        return draw(SyntheticScene(), position, lit, FrameShape(WIDTH, HEIGHT), generator)

    camera = SimulatedCamera(config.camera, see)

    def expose():
        plant = simulated.plant()
        camera.expose(plant["pos"], bool(plant["light"]))

    steps = count()

    def pause():
        if next(steps) == 1:
            simulated.control("speed 0")
            simulated.run_for(12.0)
            simulated.control("speed 1")
            assert simulated.plant()["contactor"] == 0
            time.sleep(0.25)  # The host's clock must tell of a pause, too; the simulated time went faster.
        return False

    camera.trigger = expose
    wire = Wire(simulated.edges_path, camera) if trigger == "hardware" else None
    with connect(simulated.port) as controller:
        result = run_sweep(config, tmp_path / "room", Devices(controller, camera), Hooks(should_stop=pause))
    if wire is not None:
        wire.close()
    assert (result.status, result.records) == ("complete", 2)
    journal = (tmp_path / "room" / "frames.jsonl").read_text()
    assert '"fault"' not in journal and '"retake"' not in journal
    contactor = [edge["v"] for edge in simulated.edges() if edge.get("pin") == "contactor"]
    assert contactor[-4:] == [1, 0, 1, 0]


@pytest.mark.slow
def test_the_lease_is_renewed_on_real_firmware_while_a_slow_camera_exposes(rig, tmp_path):
    """1.3 s of light by leases of at most 1 s, under a link watchdog of 500 ms; judged by the simulated laser."""
    simulated = rig(speed=1)
    config = rig_config(camera={"trigger": "software", "exposure_ms": 400.0}, sweep={"steps": 1, "turn_deg": 1.0})
    generator = np.random.default_rng(0)

    def see(position, lit):
        return draw(SyntheticScene(), position, lit, FrameShape(WIDTH, HEIGHT), generator)

    camera = SimulatedCamera(config.camera, see)

    def slow():
        def expose():
            plant = simulated.plant()
            camera.expose(plant["pos"], bool(plant["laser"] and plant["contactor"]))

        timer = threading.Timer(1.3, expose)
        timers.append(timer)
        timer.start()

    timers = []
    camera.trigger = slow
    with connect(simulated.port) as controller:
        result = run_sweep(config, tmp_path / "room", Devices(controller, camera))
    for timer in timers:
        timer.join()
    assert (result.status, result.records) == ("complete", 1)
    shone, since = [], None
    for edge in simulated.edges():
        if edge.get("pin") == "light":
            if edge["v"]:
                since = edge["cycle"]
            elif since is not None:
                shone.append((edge["cycle"] - since) / 16e6)
                since = None
    assert since is None
    # The step, and once more to close the pass; on a busy machine perhaps a retake.
    assert sum(seconds > 1.2 for seconds in shone) >= 2, shone
