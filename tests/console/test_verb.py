"""`jaxscan console` as a person types it: what it refuses, and how it ends."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from ..cli.conftest import run as run
from .conftest import CONFIG


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(CONFIG)
    return path


@pytest.mark.parametrize(
    "words, says",
    [
        (["--host", "198.51.100.7", "--web-port", "0"], "--host: found '198.51.100.7'"),
        (["-c", "missing.json"], "missing.json"),
    ],
)
def test_options_that_cannot_be_meant(run, config, words, says):
    ran = run("console", config, *words)
    assert ran.code == 1 and ran.err.startswith("jaxscan: ") and says in ran.err and ran.err.count("\n") == 1


def test_a_configuration_that_is_not_there(run, tmp_path):
    ran = run("console", tmp_path / "rig.toml")
    assert ran.code == 1 and "rig.toml" in ran.err and ran.err.count("\n") == 1


def test_without_aiohttp(run, config, monkeypatch):
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    ran = run("console", config)
    assert ran.code == 1 and ran.err == "jaxscan: The console needs aiohttp; type: pip install 'jaxscan[console]'\n"


@pytest.mark.slow
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_the_address_is_shown_once_and_ctrl_c_ends_it(config, tmp_path, host):
    command = [sys.executable, "-m", "jaxscan.cli.main", "console", str(config), "--host", host, "--web-port", "0"]
    command += ["--json", "served.json"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path
    ) as process:
        shown = process.stdout.readline()
        assert "/?token=" in shown
        more = process.stdout.readline()
        if "Ctrl-C" not in more:
            # By number, where this machine has a network.
            assert host == "0.0.0.0" and "?token=" in more
            more = process.stdout.readline()
        assert "Ctrl-C" in more
        end = time.monotonic() + 30
        while not (tmp_path / "served.json").exists():
            assert time.monotonic() < end
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    served = json.loads((tmp_path / "served.json").read_text())
    assert served["url"] in shown
    assert "token" not in served["url"] and served["format"] == "jaxscan-console/1"
    assert (process.returncode, out, err) == (130, "", "jaxscan: interrupted\n")
