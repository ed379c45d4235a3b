"""`jaxscan doctor` on the real firmware, judged by the table and by the pins."""

import json
import sys
from pathlib import Path

import pytest

from jaxscan.cli.main import main


CONFIG = """
[controller]
port = "{port}"
watchdog_ms = 60000
[turntable]
full_steps = 200
microsteps = 16
gear = {gear}
{more}
[camera]
kind = "opencv"
trigger = "free"
id = "{folder}/none"
width = 128
height = 96
"""


def examined(simulated, tmp_path, gear="[9, 1]", more=""):
    config = tmp_path / "rig.toml"
    config.write_text(CONFIG.format(port=simulated.port, gear=gear, more=more, folder=tmp_path))
    code = main(["doctor", "--config", str(config), "--json", str(tmp_path / "doctor.json")])
    found = json.loads((tmp_path / "doctor.json").read_text())["rig"]
    return code, {finding["name"]: finding for finding in found}


def dark(simulated):
    plant = simulated.plant()
    lit = [edge for edge in simulated.edges() if edge.get("pin") in ("light", "laser") and edge["v"]]
    return not lit and not plant["light"] and not plant["contactor"]


def test_a_turn_of_the_real_firmware_is_measured(rig, tmp_path):
    simulated = rig(speed=0)
    code, found = examined(simulated, tmp_path)
    # Everything but the camera, which is not there.
    assert code == 1 and found["camera"]["verdict"] == "wrong"
    for name in ("port", "firmware", "inputs", "settings", "home", "steps per turn", "laser off", "storage"):
        assert found[name]["verdict"] == "works", found[name]
    assert found["steps per turn"]["values"]["measured_microsteps"] == 28800
    # The table stands where it stood at home, not a turn farther.
    assert abs(simulated.plant()["pos"]) <= 1 and dark(simulated)


def test_another_gear_is_named(rig, tmp_path):
    simulated = rig(speed=0, microsteps_per_turn=16000)
    _, found = examined(simulated, tmp_path)
    assert found["steps per turn"]["verdict"] == "wrong"
    assert "gear = [5, 1]" in found["steps per turn"]["do"]
    assert abs(simulated.plant()["pos"]) <= 1 and dark(simulated)


def test_nothing_moves_while_the_emergency_stop_is_pressed(rig, tmp_path):
    simulated = rig(speed=0)
    simulated.control("estop 1")
    code, found = examined(simulated, tmp_path)
    assert code == 1 and found["inputs"]["found"] == "the emergency stop is pressed"
    moved = [edge for edge in simulated.edges() if edge.get("pin") == "step" and edge["v"]]
    assert not moved and dark(simulated)


@pytest.mark.slow
def test_some_other_device(rig, tmp_path, capsys):
    simulated = rig(firmware="echo")
    assert main(["doctor", "--port", simulated.port]) == 1
    assert "wrong  firmware: " in capsys.readouterr().out


def test_a_port_that_is_not_there(tmp_path, capsys):
    assert main(["doctor", "--port", str(tmp_path / "port")]) == 1
    ran = capsys.readouterr()
    assert "wrong  port: there is no port" in ran.out
    assert ran.err == "jaxscan: port must work and does not: see above.\n"


@pytest.mark.slow
def test_a_scan_of_boards_and_room_on_the_bench(rig, rendered_camera, tmp_path, monkeypatch):
    """The commands of the README, one after the other."""
    simulated = rig(speed=1.0)
    camera = rendered_camera(simulated)
    text = (Path(__file__).parents[2] / "configs" / "bench.toml").read_text()
    config = tmp_path / "bench.toml"
    text = text.replace('"hardware/bench/build/desk/port"', f'"{simulated.port}"').replace("steps = 180", "steps = 12")
    text = text.replace("free_views = 30", "free_views = 2").replace("placements = 4", "placements = 1")
    config.write_text(text.replace("angles_deg = [-10.0, -5.0, 0.0, 5.0, 10.0]", "angles_deg = [-3.0, 3.0]"))
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "--config", str(config), "--json", "doctor.json"]) == 0
    found = {finding["name"]: finding for finding in json.loads((tmp_path / "doctor.json").read_text())["rig"]}
    assert found["laser"]["verdict"] == "works" and found["trigger"]["values"]["frames"] == 6
    assert main(["scan", str(config), "-o", "room", "--json", "scan.json"]) == 0
    result = json.loads((tmp_path / "scan.json").read_text())
    assert (result["status"], result["records"]) == ("complete", 12)
    assert main(["doctor", "--capture", "room"]) == 0
    command = tmp_path / "place.py"
    socket = str(camera.folder / "camera")
    command.write_text(
        "import sys; from pathlib import Path; from bench.processes import ControlClient\n"
        f"print(ControlClient(Path({socket!r})).ask('board ' + sys.argv[1]))\n"
    )
    words = ["--boards", "--place-command", f"{sys.executable} {command}"]
    assert main(["scan", str(config), "-o", "boards", *words]) == 0
    plant = simulated.plant()
    assert not plant["light"] and not plant["contactor"]
