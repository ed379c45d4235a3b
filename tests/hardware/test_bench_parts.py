"""Parts of the bench that die, and locks that somebody else has prepared."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bench.camera import loopback
from bench.desk import Desk, claimed
from bench.places import BenchError, held, own_folder, private_folder
from bench.processes import launch


def held_at(path, timeout_s=0.0):
    return held(path, timeout_s=timeout_s, busy="busy")


def test_a_lock_is_held_by_one_and_its_content_stays(tmp_path):
    path = tmp_path / "lock"
    path.write_text("as it was")
    with held_at(path):
        with pytest.raises(BenchError, match="busy"), held_at(path):
            pass
    with held_at(path):
        pass
    assert path.read_text() == "as it was"


@pytest.mark.parametrize("kind", ["link", "dangling", "pipe", "folder", "theirs"])
def test_a_lock_that_is_no_plain_file_of_this_user_is_refused(tmp_path, kind):
    path, victim = tmp_path / "lock", tmp_path / "victim"
    victim.write_text("precious")
    match kind:
        case "link":
            path.symlink_to(victim)
        case "dangling":
            path.symlink_to(tmp_path / "made")
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "theirs":
            path.touch()
            if os.getuid() != 0:
                pytest.skip("only root can give a file away")
            os.chown(path, 12345, 12345)
    with pytest.raises(BenchError, match="cannot be used as a lock"), held_at(path):
        pass
    assert victim.read_text() == "precious" and not (tmp_path / "made").exists()


def test_the_lock_of_a_process_that_was_killed_is_free(tmp_path):
    code = "import sys, time; from bench.places import held; from pathlib import Path\n"
    code += "with held(Path(sys.argv[1]), timeout_s=0, busy=''): print('held', flush=True); time.sleep(60)"
    lock = own_folder(tmp_path / "desk") / "lock"
    with subprocess.Popen([sys.executable, "-c", code, str(lock)], stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(BenchError, match="runs already"), claimed(tmp_path / "desk"):
            pass
        other.kill()
    with claimed(tmp_path / "desk"):
        pass


def test_locks_between_benches_are_in_a_folder_of_this_user(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert private_folder() == tmp_path / "jaxscan" and (tmp_path / "jaxscan").stat().st_mode & 0o777 == 0o700
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert private_folder() == tmp_path / f"jaxscan-{os.getuid()}"
    os.chmod(private_folder(), 0o777)
    with pytest.raises(BenchError, match="nobody else may write"):
        private_folder()
    (tmp_path / "link").symlink_to(tmp_path / "jaxscan")
    with pytest.raises(BenchError, match="expected a folder of this user"):
        own_folder(tmp_path / "link")


class Dark:
    """A camera that is well."""

    def died(self):
        return ""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_simulator_that_dies_is_named(rig, end):
    simulated = rig(speed=0)
    desk = Desk(simulated, Dark())
    desk.require_alive()
    (number,) = children(os.getpid(), "simrun")
    os.kill(number, end)
    limit = time.monotonic() + 5
    while not simulated.died():
        assert time.monotonic() < limit
        time.sleep(0.01)
    with pytest.raises(BenchError, match=r"the simulator has ended \((killed by signal 9|exit code 0)\); the bench"):
        desk.require_alive()
    simulated.close()
    assert simulated.died() == ""
    assert not any(os.path.lexists(path) for path in (simulated.port, simulated.control_path))


def children(parent, name):
    """Numbers of the processes that a process has started and whose command line holds a name."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            line = (folder / "cmdline").read_bytes().decode(errors="replace")
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == parent and name in line:
                found.append(int(folder.name))
        except (OSError, IndexError):
            continue
    return found


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("part", ["simrun", "bench.camera", "bench"])
def test_a_bench_whose_part_is_killed_ends_and_leaves_the_place_free(tmp_path, whole_bench, part, seed):
    """At any moment after it is set up; of the bench itself at any moment of the start too."""
    generator, folder = random.Random(seed), tmp_path / "bench"
    with loopback():
        pass
    command = [sys.executable, "-m", "bench"]
    with open(tmp_path / "said", "w") as said:
        bench = subprocess.Popen(command, env=whole_bench, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
    try:
        limit = time.monotonic() + generator.uniform(0.0, 15.0) + (0.0 if part == "bench" else 600.0)
        while "quit" not in (tmp_path / "said").read_text() and time.monotonic() < limit:
            assert bench.poll() is None, (tmp_path / "said").read_text()
            time.sleep(0.05)
        time.sleep(generator.uniform(0.0, 1.0))
        parts = {name: children(bench.pid, name) for name in ("simrun", "bench.camera")}
        os.kill(bench.pid if part == "bench" else parts[part][0], signal.SIGKILL)
        status = bench.wait(10)
    finally:
        bench.kill()
        bench.wait(10)
    last = (tmp_path / "said").read_text().splitlines()[-1]
    if part != "bench":
        name = {"simrun": "the simulator", "bench.camera": "the camera"}[part]
        assert status == 1 and last == f"bench: {name} has ended (killed by signal 9); the bench is shut down."
        assert not any(os.path.lexists(folder / left) for left in ("port", "control", "camera"))
    # The others end with it: the address and the folder are free at once.
    limit = time.monotonic() + 10
    while any(Path(f"/proc/{number}").exists() for numbers in parts.values() for number in numbers):
        assert time.monotonic() < limit
        time.sleep(0.05)
    with claimed(folder), loopback(timeout_s=5.0):
        pass


def test_ctrl_c_while_a_program_starts_ends_it(tmp_path, monkeypatch):
    begun, popen = [], subprocess.Popen

    def noted(*given, **options):
        begun.append(popen(*given, **options))
        return begun[-1]

    def interrupt(selector, timeout_s):
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", noted)
    monkeypatch.setattr("selectors.DefaultSelector.select", interrupt)
    silent = [sys.executable, "-c", "import time; time.sleep(60)"]
    with pytest.raises(KeyboardInterrupt):
        launch(silent, folder=tmp_path, errors=tmp_path / "errors", within_s=20)
    assert begun[0].returncode == -signal.SIGKILL and begun[0].stdout.closed


def test_last_words_of_a_program_may_be_of_any_bytes(tmp_path):
    dying = [sys.executable, "-c", r"import os; os.write(2, b'no port \xff')"]
    with pytest.raises(BenchError, match="did not start: no port"):
        launch(dying, folder=tmp_path, errors=tmp_path / "errors", within_s=20)
