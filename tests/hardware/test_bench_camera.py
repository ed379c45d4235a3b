"""The camera on the bench: a frame for every pulse of the trigger wire, showing the plant during the pulse."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import serial
from bench.camera.rendered import loopback
from bench.places import WORLD
from bench.processes import ControlClient
from scanrig.cameras import CameraSettings, open_camera
from scanrig.errors import CameraLost, CameraTimeout

from jaxscan.files.disk import load_toml
from jaxscan.simulation import SimulationConfig, expect_record, make_rig, make_scene

from .driving import ready


TURN = 28800
WAIT_S = 20.0
"""For a frame that comes, on a busy machine."""
SETTINGS = CameraSettings(
    kind="aravis",
    id="127.0.0.1",
    width=640,
    height=512,
    trigger="hardware",
    trigger_source="Software",
    packet_size=8000,
)


@pytest.fixture
def controller(rig):
    simulated = rig(speed=0)
    short = {"settle_ms": 1, "laser_on_ms": 2, "laser_off_ms": 2, "exposure_ms": 10, "gap_ms": 1}
    with ready(simulated, **short) as controller:
        controller.simulated = simulated
        yield controller


def shoot(controller, to, number):
    """One shot, real time where the exposures are close."""
    # At the rig's speed a minute goes by while a frame is rendered, and the contactor does not wait that long.
    controller.arm(True)
    controller.shot(to, number)
    controller.wait_shot(number)


def departure(image, expected, sensor):
    """Mean squared departure of a frame from an expectation, in units of the sensor's own noise."""
    variance = np.maximum(expected, 0) / sensor.electrons_per_dn + sensor.read_dn**2 + 1 / 12
    fair = (expected > 5) & (expected < 250)
    return float(np.mean((image[fair] - expected[fair]) ** 2 / variance[fair]))


def test_frames_are_what_the_simulator_renders_at_the_plants_angle(controller, rendered_camera):
    world = load_toml(WORLD, SimulationConfig)
    scene_rig, scene = make_rig(world), make_scene(world)
    bench = rendered_camera(controller.simulated)
    with open_camera(SETTINGS) as camera:
        camera.start()
        for number, to in enumerate((160, 7200), start=1):
            shoot(controller, to, number)
            assert controller.simulated.plant()["pos"] == to
            on, off = camera.next(WAIT_S), camera.next(WAIT_S)
            assert on.complete and off.complete and off.number == on.number + 1
            phi = 2 * np.pi * to / TURN
            record = expect_record(scene_rig, scene, phi)
            # A mean of 3e5 squared standard normals: 1 within 1 %, and a little more for the rounding at the dark end.
            assert departure(on.image, record.off + record.laser, world.sensor) == pytest.approx(1, abs=0.05)
            assert departure(off.image, record.off, world.sensor) == pytest.approx(1, abs=0.05)
            # That this can fail: by the laser, and by a tenth of a degree.
            assert departure(off.image, record.off + record.laser, world.sensor) > 1.5
            beside = expect_record(scene_rig, scene, phi + 2 * np.pi / 3600)
            assert departure(off.image, beside.off, world.sensor) > 1.5
        bench.settle()
        truth = bench.frames()
        assert [frame["light"] for frame in truth] == [1.0, 0.0] * 2
        assert [frame["position"] for frame in truth] == [160, 160, 7200, 7200]


def test_frames_of_16_bits_have_the_same_light_in_finer_steps(controller, rendered_camera):
    world = load_toml(WORLD, SimulationConfig)
    record = expect_record(make_rig(world), make_scene(world), 2 * np.pi * 160 / TURN)
    rendered_camera(controller.simulated)
    with open_camera(SETTINGS.model_copy(update={"pixel_format": "mono16"})) as camera:
        camera.start()
        shoot(controller, 160, 1)
        frames = [camera.next(WAIT_S) for _ in range(2)]
    for frame, expected in zip(frames, (record.off + record.laser, record.off), strict=True):
        assert frame.complete and frame.image.dtype == np.uint16 and frame.bits == 16
        # Of less variance than in 8 bits by that of their rounding, some per cent.
        assert departure(frame.image / 256.0, expected, world.sensor) == pytest.approx(1, abs=0.08)
        assert np.count_nonzero(frame.image % 256) > 0.9 * frame.image.size


@pytest.mark.slow
def test_no_frame_is_lost_that_was_not_asked_to_be(controller, rendered_camera):
    bench = rendered_camera(controller.simulated)
    with open_camera(SETTINGS) as camera:
        camera.start()
        # 25 exposures, the next always while the frame before is on its way.
        for number in range(1, 13):
            shoot(controller, 80 * number, number)
        controller.trigger()
        frames = [camera.next(WAIT_S) for _ in range(25)]
        assert np.all(np.diff([frame.number for frame in frames]) == 1)
        with pytest.raises(CameraTimeout):
            camera.next(0.5)
        assert [frame["position"] for frame in bench.frames()] == [80 * (k // 2 + 1) for k in range(24)] + [960]

        bench.control("lose 1")
        shoot(controller, 80, 20)
        assert dark(camera.next(WAIT_S), frames)
        with pytest.raises(CameraTimeout):
            camera.next(0.5)

        bench.control("swap")
        shoot(controller, 80, 21)
        assert [dark(camera.next(WAIT_S), frames) for _ in range(2)] == [True, False]

        bench.control("flash 100")
        shoot(controller, 80, 22)
        on, off = camera.next(WAIT_S), camera.next(WAIT_S)
        assert np.median(on.image) > np.median(off.image) + 90

        bench.control("cover 1")
        shoot(controller, 80, 23)
        assert max(np.median(camera.next(WAIT_S).image) for _ in range(2)) < 5
        bench.control("cover 0")

        bench.control("loss 0.05")
        shoot(controller, 80, 24)
        bench.settle()
        assert not all(next_frames(camera, 2))
        bench.control("loss 0")

        described = bench.control("board placement 1")
        assert described["kind"] == "placement" and described["angles_deg"][0] <= -10
        shoot(controller, 80, 25)
        bench.settle()
        camera.drop()
        assert bench.frames()[-1]["board"] == described["board"] == 31

        bench.control("disappear")
        with pytest.raises(CameraLost):
            for _ in range(8):  # Some may still be under way.
                camera.next(WAIT_S)
        bench.control("appear")
        bench.control("board none")
        camera.reopen()
        camera.start()
        shoot(controller, 80, 26)
        assert not dark(camera.next(WAIT_S), frames) and dark(camera.next(WAIT_S), frames)


def next_frames(camera, count):
    """Which of the next frames came whole; one that does not come at all did not."""
    whole = []
    for _ in range(count):
        try:
            whole.append(camera.next(2.0).complete)
        except CameraTimeout:
            whole.append(False)
    return whole


def dark(frame, frames):
    """Whether no laser shines in a frame, all of them from the same angle: by the pixels that its line made bright."""
    on, off = (frames[k].image.astype(int) for k in (0, 1))
    line = on - off > 30
    assert line.sum() > 200
    return np.median(frame.image[line]) < (np.median(on[line]) + np.median(off[line])) / 2


def started(command, environment):
    """A bench and its output so far, as soon as no other test holds the camera's address."""
    limit = time.monotonic() + 200
    while True:
        with loopback():
            pass
        bench = subprocess.Popen(
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        said = bench.stdout.readline() + bench.stdout.readline()
        if "is taken" not in said:
            return bench, said
        assert time.monotonic() < limit, said
        bench.wait(10)
        bench.stdin.close()
        bench.stdout.close()


@pytest.mark.slow
def test_the_whole_bench_from_its_terminal(tmp_path, whole_bench):
    command = [sys.executable, "-m", "bench"]
    bench, said = started(command, whole_bench)
    try:
        while "quit" not in said:
            line = bench.stdout.readline()
            assert line, said
            said += line
        for pages in ("docs/console.md", "docs/first-room.md"):
            text = (Path(__file__).resolve().parents[2] / pages).read_text()
            assert re.search(r"jaxscan console configs/bench.toml --place-command .*?place\"", text)[0] in said
        assert "jaxscan scan configs/bench.toml" in said and str(tmp_path / "bench" / "port") in said
        second = subprocess.run(command, env=whole_bench, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        assert second.returncode == 1 and "runs already" in second.stderr
        placed = subprocess.run([*command, "place", "2"], env=whole_bench, capture_output=True, text=True)
        assert placed.returncode == 0 and '"board": 2' in placed.stdout
        bench.stdin.write("\ne\n")
        bench.stdin.flush()
        # Enter shows the pose after the one that another program asked for.
        while "board in pose 3" not in (line := bench.stdout.readline()):
            assert line
        control = ControlClient(tmp_path / "bench" / "control")
        limit = time.monotonic() + 10
        while '"estop":1' not in control.ask("state"):
            assert time.monotonic() < limit
        control.close()
        with serial.Serial(str(tmp_path / "bench" / "port"), 250_000):
            bench.send_signal(signal.SIGINT)
            assert bench.wait(30) == 130
        assert not os.path.lexists(tmp_path / "bench" / "port")
    finally:
        if bench.poll() is None:
            bench.kill()
            bench.wait(10)
        bench.stdin.close()
        bench.stdout.close()
