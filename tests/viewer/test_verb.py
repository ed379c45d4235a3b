"""`jaxscan view` as a person types it: what it refuses, and how it ends."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from jaxscan.web import open_address

from ..cli.conftest import run as run


AXES = "".join(f"property float {axis}\n" for axis in "xyz")
EMPTY = f"ply\nformat ascii 1.0\nelement vertex 0\n{AXES}end_header\n"


@pytest.mark.parametrize(
    "words, says",
    [
        (["--web-port", "-1"], "--web-port: found -1, expected 0 ... 65535."),
        (["--host", "198.51.100.7", "--web-port", "0"], "--host: found '198.51.100.7'"),
        (["-c", "missing.json"], "missing.json"),
        (["--panorama", "missing.jpg"], "missing.jpg"),
    ],
)
def test_options_that_cannot_be_meant(run, tiny, words, says):
    ran = run("view", tiny.cloud, *words)
    assert ran.code == 1 and ran.err.startswith("jaxscan: ") and says in ran.err and ran.err.count("\n") == 1


def test_a_port_that_is_taken(run, tiny):
    taken = open_address("127.0.0.1", 0, option="--web-port")
    ran = run("view", tiny.cloud, "--web-port", taken.port)
    taken.socket.close()
    line = f"jaxscan: --web-port: the port {taken.port} is taken by another program; choose another, or 0 for any"
    assert ran.code == 1 and ran.err == f"{line} that is free.\n"


@pytest.mark.parametrize(
    "text, says",
    [
        ("ply\n", "room.ply"),
        ("solid mesh", "room.ply"),
        (EMPTY, "no points"),
    ],
)
def test_what_is_no_cloud(run, tmp_path, text, says):
    cloud = tmp_path / "room.ply"
    cloud.write_text(text)
    ran = run("view", cloud, "--web-port", 0)
    assert ran.code == 1 and ran.err.startswith("jaxscan: ") and says in ran.err and ran.err.count("\n") == 1


def test_more_panoramas_than_clouds(run, tiny, tmp_path):
    pictures = [tmp_path / name for name in ("a.jpg", "b.jpg")]
    for path in pictures:
        path.write_bytes(b"")
    ran = run("view", tiny.cloud, "--panorama", *pictures)
    assert ran.code == 1 and ran.err == "jaxscan: --panorama: found 2 pictures for 1 clouds; name one for each.\n"


def test_without_aiohttp(run, tiny, monkeypatch):
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    ran = run("view", tiny.cloud)
    assert ran.code == 1 and ran.err == "jaxscan: The viewer needs aiohttp; type: pip install 'jaxscan[view]'\n"


@pytest.mark.rig
def test_the_address_is_said_and_a_signal_ends_it(tiny, tmp_path):
    command = [sys.executable, "-m", "jaxscan.cli.main", "view", str(tiny.cloud), "--web-port", "0"]
    command += ["--no-open", "--json", "served.json"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path
    ) as process:
        said = process.stdout.readline() + process.stdout.readline()
        end = time.monotonic() + 30
        while not (tmp_path / "served.json").exists():
            assert time.monotonic() < end
        # Not Ctrl-C's, which a shell lets processes in the background ignore.
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=30)
    assert "http://127.0.0.1:" in said and "/?token=" in said
    assert (process.returncode, out, err) == (143, "", "jaxscan: interrupted\n")
    assert json.loads((tmp_path / "served.json").read_text())["format"] == "jaxscan-view/1"
