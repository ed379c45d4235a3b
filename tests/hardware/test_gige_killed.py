"""Scans with the network camera that are killed: what they leave is an open port and a camera under their control.

experiments/kills.py does the same at length, with the command line and the rendered room.
"""

import json
import math
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from jaxscan.files.capture import verify_capture

from .scanning import see
from .test_session_killed import Scan, kill_and_go_on


TURN = 28800
ROOT = Path(__file__).resolve().parents[2]


class DrawnWorld:
    """A line on a wall, drawn in a millisecond."""

    def frame(self, view, number, **_):
        generator = np.random.default_rng(number % (1 << 32))
        return see(round(view.angle / (2 * math.pi) * TURN), view.lights[0] > 0, generator)


@pytest.fixture
def gige(loopback, tmp_path):
    """Starts the bench's camera within this process, in front of a rig; it draws instead of rendering."""
    from bench.camera.network import BenchCamera

    made = []

    def make(simulated):
        ledger = open(tmp_path / "frames.jsonl", "a")
        camera = BenchCamera(DrawnWorld(), simulated.edges_path, TURN, ledger, loopback)
        thread = threading.Thread(target=camera.run)
        thread.start()
        made.append((camera, thread, ledger))
        return camera

    yield make
    for camera, thread, ledger in made:
        camera.stop()
        thread.join(20)
        ledger.close()


def test_09_killed_with_the_network_camera_it_goes_on(rig, gige, tmp_path):
    """Fault 9 with a camera that keeps its controller until a heartbeat is missed."""
    simulated = rig(speed=10)
    camera = gige(simulated)
    one = Scan(simulated, tmp_path / "room", 20, gige=True)
    assert kill_and_go_on(one, 2, seed=4) >= 1
    one.require_complete()
    one.require_whole()
    one.require_dark()
    assert verify_capture(one.folder) == [] and camera.counts.refused == 0


def test_16_control_that_is_lost_in_mid_scan_is_taken_again(rig, gige, tmp_path):
    """Fault 16: the camera forgets who controls it, as after its own restart or a long freeze of the host."""
    simulated = rig(speed=10)
    camera = gige(simulated)
    one = Scan(simulated, tmp_path / "room", 20, gige=True)
    child = one.begin()
    one.await_pairs(5)
    camera.forget_controller()
    assert one.end(child) == 0, one.words()
    assert one.events("camera") and one.events("recovered")
    one.require_whole()
    one.require_dark()


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_09_killed_fifty_times_on_the_whole_bench_it_goes_on(whole_bench, tmp_path):
    """The command line, the firmware, the GigE camera and the rendered room, as the experiment verifies it."""
    answer = tmp_path / "figures.json"
    command = [sys.executable, "-m", "experiments.kills", "--kills", "50", "--seed", "9", "--json", str(answer)]
    done = subprocess.run(command, cwd=ROOT, env=whole_bench, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr[-4000:]
    figures = json.loads(answer.read_text())
    assert figures["kills"] == 50 and figures["kills_with_records"] >= 10
    assert figures["sessions_failed"] == figures["journal_lines_lost"] == figures["shots_lost"] == 0
    assert figures["captures"] == figures["captures_clean"] and figures["images"] == figures["images_right"]
