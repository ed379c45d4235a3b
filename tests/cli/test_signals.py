"""A signal ends the process at once, whatever it does; only a rig in use is left in order."""

import os
import select
import signal
import subprocess
import sys
import time

import pytest


pytestmark = pytest.mark.rig


BEGIN = """
import ctypes, hashlib, os, signal, sys, threading, time
from jaxscan.cli import signals
signals.listen()
def ready():
    os.write(1, b"ready")
"""
SLEEPING = "ready(); time.sleep(60)"
# Without looking for signals, and with the interpreter free for other threads, as in XLA's compiler.
COMPILED = "ready(); hashlib.pbkdf2_hmac('sha512', b'a', b'b', 2**31 - 1)"
SWALLOWING = """
ready()
while True:
    try:
        time.sleep(60)
    except BaseException:
        pass
"""
WITH_FILES = """
from pathlib import Path
from jaxscan.files.disk.writing import partial_file, partial_folder
with partial_file(Path("cloud.ply")) as file, partial_folder(Path("captures")) as folder:
    file.write_bytes(b"half")
    (folder / "inner").mkdir()
    (folder / "inner" / "image.png").write_bytes(b"half")
    ready()
    time.sleep(60)
"""
RIG = """
try:
    with signals.RigInUse() as rig:
        try:
            ready()
            time.sleep(60)
        finally:
            rig.closing()
            os.write(1, b"closing")
            end = time.monotonic() + 3
            while time.monotonic() < end:
                time.sleep(0.05)
            os.write(1, b"laser off")
except KeyboardInterrupt as interrupt:
    os.write(1, f" {interrupt} {signals.exit_code(interrupt)}".encode())
    os._exit(7)
"""
CLOSING = """
try:
    with signals.RigInUse() as rig:
        rig.closing()
        ready()
        end = time.monotonic() + 2
        while time.monotonic() < end:
            time.sleep(0.05)
        os.write(1, b"closed")
except KeyboardInterrupt as interrupt:
    os.write(1, f" {interrupt}".encode())
    os._exit(7)
"""


HEARD = "--default-signal=INT,TERM,HUP"
"""As in a shell, whatever the tests were started from; an option of `env`."""


def started(code, folder, *, signals=(HEARD,)):
    child = subprocess.Popen(
        ["env", *signals, sys.executable, "-c", BEGIN + code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=folder,
    )
    wait_for(child, b"ready")
    return child


def wait_for(child, word):
    said = b""
    while word not in said:
        assert select.select([child.stdout], [], [], 60)[0], said
        said += (piece := os.read(child.stdout.fileno(), 100))
        assert piece, (said, child.stderr.read())


def ended(child, number):
    since = time.monotonic()
    child.send_signal(number)
    out, err = child.communicate(timeout=30)
    return child.returncode, time.monotonic() - since, err.decode(), out.decode()


@pytest.mark.parametrize("code", [SLEEPING, COMPILED, SWALLOWING, WITH_FILES], ids=["waits", "C", "swallows", "files"])
@pytest.mark.parametrize(("number", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_with_one_line_and_leaves_nothing(tmp_path, code, number, exit_code):
    returned, seconds, err, _ = ended(started(code, tmp_path), number)
    assert (returned, err) == (exit_code, "jaxscan: interrupted\n")
    assert seconds < 2.0
    assert list(tmp_path.iterdir()) == []


def test_many_signals_are_answered_once(tmp_path):
    child = started(WITH_FILES, tmp_path)
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        child.send_signal(number)
    _, err = child.communicate(timeout=30)
    assert child.returncode in (130, 143) and err == b"jaxscan: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_what_the_caller_ignores_stays_ignored(tmp_path, name):
    number = getattr(signal, name)

    child = started("ready(); time.sleep(2)", tmp_path, signals=(HEARD, f"--ignore-signal={name[3:]}"))
    assert ended(child, number)[0] == 0


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_rig_in_use_is_closed_first_and_further_signals_wait(tmp_path, name):
    child = started(RIG, tmp_path)
    child.send_signal(getattr(signal, name))
    wait_for(child, b"closing")
    child.send_signal(signal.SIGTERM)
    returned, seconds, err, out = ended(child, signal.SIGINT)
    assert seconds > 2.0, "the watcher must not cut it off"
    code = {"SIGINT": 130, "SIGTERM": 143}[name]
    assert (returned, err, out) == (7, "", f"laser off {name} {code}")


def test_a_signal_while_a_rig_is_closed_counts_afterwards(tmp_path):
    returned, _, err, out = ended(started(CLOSING, tmp_path), signal.SIGTERM)
    assert (returned, err, out) == (7, "", "closed SIGTERM")


def test_the_line_of_a_bar_is_cleared(tmp_path):
    child = started("signals.leave_behind(b'<clear>'); ready(); time.sleep(60)", tmp_path)
    assert ended(child, signal.SIGINT)[2] == "<clear>jaxscan: interrupted\n"


def test_nothing_is_loaded_before_signals_are_heard():
    code = "import sys; before = set(sys.modules); import jaxscan.cli.main; print(*sorted(set(sys.modules) - before))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = [name for name in run.stdout.split() if not name.startswith("jaxscan")]
    assert loaded == []
