"""The whole loop: command line, serial line, firmware, trigger, GigE camera, calibration, cloud, walls."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.usefixtures("rig")
@pytest.mark.parametrize("options", [[], ["--two-lasers"]], ids=["one laser", "two lasers"])
def test_walls_of_a_room_that_came_through_the_loop(tmp_path, options):
    from bench.camera.network import aravis_is_there

    if not aravis_is_there():
        pytest.skip("a camera on loopback needs libaravis-0.8-0: type `make bench-deps`")
    answer = tmp_path / "figures.json"
    command = [sys.executable, "-m", "experiments.closed_loop", *options, "--json", str(answer)]
    done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = {metric["key"]: metric["value"] for metric in json.loads(answer.read_text())["figures"]}
    # Every pair shows the angle and the light that its record names.
    assert figures["shots_right"] == 100.0
    # Each wall, floor and ceiling is within 5 mm of its true place, as surveyors of interiors require.
    assert figures["planes"] == 6
    assert figures["worst_wall"] < 5.0
    # The cloud that grew during the scan is that of `jaxscan reconstruct`; float32 differs between compiled functions.
    assert figures["live_cloud_apart"] < 1e-2
    assert figures["live_cloud_differs"] == 0
