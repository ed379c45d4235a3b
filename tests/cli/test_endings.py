"""Every way in which a verb may end, as a person sees it: at most one line, an exit code, nothing for the terminal."""

import json
import os
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

from jaxscan.cli.environment import cache_folder
from jaxscan.cli.terminal import console, emit_json, table
from jaxscan.errors import CloudError

from ..files.clouds import make_cloud


EVIL = "a\x1b]52;c;aGk=\x07\x9b31m\u202eb\udcff\n"
SHOWN = r"a\x1b]52;c;aGk=\x07\x9b31m\u202eb\udcff"


def test_nothing_that_is_printed_is_a_command(capsys):
    out = console()
    out.print(f"note: {EVIL}", style="bold")
    out.print(table(EVIL, (EVIL, "two"), [(EVIL, "[red]3[/red] :smile:")]))
    said = capsys.readouterr().out
    assert said.count(SHOWN) == 4 and "[red]3[/red] :smile:" in said
    assert all(one.isprintable() or one == "\n" for one in said)


@pytest.mark.rig
def test_a_terminal_shows_colours_but_obeys_no_name(monkeypatch):
    monkeypatch.delenv("NO_COLOR")
    ours, theirs = os.openpty()
    code = (
        "import sys; from jaxscan.cli.terminal import console; from jaxscan.cli.terminal import table\n"
        f"console().print({EVIL!r}, style='bold red'); console().print(table('t', ('a',), [({EVIL!r},)]))"
    )
    subprocess.run(
        [sys.executable, "-c", code], stdout=theirs, env={**os.environ, "TERM": "xterm-256color"}, check=True
    )
    os.close(theirs)
    said = os.read(ours, 10000).decode()
    os.close(ours)
    assert said.count(SHOWN) == 2
    commands = set(re.findall(r"\x1b.{0,6}", said))
    assert commands and all(re.match(r"\x1b\[[0-9;]*m", command) for command in commands)


@pytest.mark.parametrize(
    "words", [["measure", "room", EVIL], ["measure", EVIL], [EVIL], ["convert", "a.ply", "b.ply", f"--{EVIL}"]]
)
def test_words_are_quoted_as_text(words, run):
    ran = run(*words)
    assert ran.code in (1, 2) and ran.out == ""
    assert "\\x1b]52" in ran.err
    assert all(one.isprintable() or one == "\n" for one in ran.err)


class Failing:
    """A cloud's reader that fails in a way that nobody foresaw."""

    def __init__(self, problem):
        self.problem = problem

    def __call__(self, path):
        raise self.problem


@pytest.fixture
def failing(run, monkeypatch, tmp_path):
    """`jaxscan measure plane` on a cloud whose reader fails."""

    def call(problem, *words):
        monkeypatch.setattr("jaxscan.files.clouds.read_cloud", Failing(problem))
        return run("measure", "plane", tmp_path / "a.ply", "--at", "0", "0", "0", *words)

    return call


@pytest.mark.parametrize(
    ("problem", "code", "says"),
    [
        (CloudError(EVIL), 1, "jaxscan: " + SHOWN),
        (
            MemoryError("Unable to allocate 7 PiB"),
            1,
            r"jaxscan: \S+/a\.ply: too large for the memory of this machine\.",
        ),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), 1, r"jaxscan: \S+/a\.ply: too large for the memory"),
        (RecursionError("maximum recursion depth"), 1, r"jaxscan: \S+/a\.ply: nested too deeply"),
        (OSError(28, "No space left on device", "x.ply"), 1, r"jaxscan: x\.ply: No space left on device\."),
        (BrokenPipeError(32, "Broken pipe"), 141, ""),
        (KeyboardInterrupt(), 130, "jaxscan: interrupted"),
        (KeyboardInterrupt("SIGTERM"), 143, "jaxscan: interrupted"),
        (KeyboardInterrupt("SIGTERM, then SIGINT"), 143, "jaxscan: interrupted"),
        (
            ValueError(EVIL),
            70,
            r"jaxscan: this is a defect of jaxscan, not of your files: ValueError in measure\.py, line",
        ),
        (KeyError("x" * 9999), 70, "jaxscan: this is a defect of jaxscan, not of your files: KeyError"),
        (AssertionError(), 70, "jaxscan: this is a defect of jaxscan, not of your files: AssertionError"),
    ],
    ids=lambda one: type(one).__name__ if isinstance(one, BaseException) else "",
)
def test_every_error_is_one_line(failing, problem, code, says):
    ran = failing(problem)
    assert (ran.code, ran.out, ran.err.count("\n")) == (code, "", int(bool(says)))
    line = ran.err.rstrip("\n")
    assert line.isprintable() and len(line) < 600
    assert SHOWN in line if isinstance(problem, CloudError) else re.match(says, line)


@pytest.mark.parametrize("problem", [ValueError("a"), MemoryError(), RecursionError(), CloudError("b")])
def test_debug_shows_the_error_itself(failing, problem):
    with pytest.raises(type(problem)):
        failing(problem, "--debug")


def test_json_that_cannot_be_written_is_an_error(monkeypatch, run, tmp_path):
    emit_json({})
    monkeypatch.setattr(sys, "stdout", None)
    import jaxscan

    jaxscan.save_cloud(make_cloud(), tmp_path / "a.ply")
    ran = run("convert", tmp_path / "a.ply", tmp_path / "b.npz", "--json", "-")
    assert ran.code == 1 and "standard output: is closed" in ran.err


PROCESS = [sys.executable, "-m", "jaxscan.cli.main"]


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    import jaxscan

    path = tmp_path_factory.mktemp("cloud") / "a.ply"
    jaxscan.save_cloud(make_cloud(), path)
    return path


def shell(command, cloud, **env):
    """Run in a shell, where PROCESS is `$J`; environment variables given as None are absent."""
    changed = {**os.environ, "J": " ".join(PROCESS), "A": str(cloud), "JAX_PLATFORMS": "cpu", **env}
    kept = {name: value for name, value in changed.items() if value is not None}
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, env=kept, timeout=120, cwd=cloud.parent
    )


@pytest.mark.rig
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_under_standard_output(cloud):
    ran = shell("$J convert $A b.npz --json - > /dev/full", cloud)
    assert (ran.returncode, ran.stderr.splitlines()[1:]) == (
        1,
        ["jaxscan: standard output: cannot be written: No space left on device."],
    )
    ran = shell("$J convert $A b.npz > /dev/full", cloud)
    assert (ran.returncode, ran.stderr) == (
        1,
        "jaxscan: standard output: cannot be written: No space left on device.\n",
    )
    ran = shell("$J --help > /dev/full", cloud)
    assert (ran.returncode, ran.stderr.count("\n")) == (
        0,
        0,
    ) or ran.stderr == "jaxscan: standard output: No space left on device.\n"


@pytest.mark.rig
@pytest.mark.parametrize("words", ["convert $A b.npz", "convert $A b.npz --json -", "measure --help"])
def test_nobody_reads(words, cloud):
    ran = shell(f"$J {words} | true; exit ${{PIPESTATUS[0]}}", cloud)
    assert ran.stderr.replace("written: b.npz (18 points)\n", "") == ""
    assert ran.returncode in (0, 141)


@pytest.mark.rig
def test_nobody_reads_errors(cloud):
    ran = shell("$J convert none.ply b.npz 2>&1 >/dev/null | true; exit ${PIPESTATUS[0]}", cloud)
    assert (ran.returncode, ran.stdout + ran.stderr) == (1, "")


@pytest.mark.rig
@pytest.mark.parametrize("closed", ["1>&-", "2>&-", "0<&-", "0<&- 1>&- 2>&-"])
def test_closed_standard_files_are_not_replaced_by_outputs(closed, cloud):
    ran = shell(f"$J convert $A b.ply {closed}; echo $? > code", cloud)
    assert ran.stdout + ran.stderr in ("", "written: b.ply (18 points)\n")
    assert (cloud.parent / "code").read_text() == "0\n"
    assert (cloud.parent / "b.ply").read_bytes().startswith(b"ply\n")


@pytest.mark.rig
def test_json_where_standard_output_is_latin(cloud):
    ran = shell(
        "cp $A $'\\u0436\\xff.ply'; $J convert $'\\u0436\\xff.ply' b.npz --json -", cloud, PYTHONIOENCODING="latin-1"
    )
    assert ran.returncode == 0 and ran.stdout.isascii()
    assert json.loads(ran.stdout)["source"].startswith("ж")


BECOME = (
    "setpriv --reuid 54321 --regid 54321 --clear-groups --inh-caps=+dac_read_search --ambient-caps=+dac_read_search"
)


@pytest.fixture
def open_folder():
    """A folder that every user may write; those of pytest are closed to others."""
    with tempfile.TemporaryDirectory() as path:
        for name in ("free", "tmp"):
            os.mkdir(os.path.join(path, name))
            os.chmod(os.path.join(path, name), 0o777)
        os.chmod(path, 0o755)
        yield Path(path)


LOADED = ("", "XDG_CACHE_HOME=/dev/null")
"""Where libraries are loaded that keep what they make: a home that is not there, and one that is no folder."""


@pytest.mark.rig
@pytest.mark.parametrize("home", ["", "HOME=/", "HOME=/nonexistent", "XDG_CACHE_HOME=/dev/null", "HOME=/root"])
def test_no_home_and_an_unknown_user(cloud, open_folder, home):
    """As in `docker run -u 54321`: not in the list of users, and nothing of the installation may be written."""
    if os.getuid() != 0 or shell(f"{BECOME} true", cloud).returncode:
        pytest.skip("needs root and setpriv")
    # What the reports load, with a cache of its own.
    loading = "from jaxscan.cli import environment; environment.choose_caches(); import matplotlib.pyplot"
    clean = f"env -i PATH=$PATH PYTHONPATH=$PYTHONPATH TMPDIR={open_folder}/tmp {home}"
    ran = shell(
        f'cd {open_folder}/free; P="{BECOME} {clean}"; $P $J convert $A b.npz; echo $?; '
        f"$P {sys.executable} -c '{loading if home in LOADED else 'pass'}'; echo $?; ls -A",
        cloud,
    )
    assert ran.stderr == "" and ran.stdout.splitlines()[1:] == ["0", "0", "b.npz"], ran
    (kept,) = (open_folder / "tmp").iterdir()
    assert kept.name == "jaxscan-54321" and kept.stat().st_mode & 0o077 == 0


def test_a_cache_that_others_may_write_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    folder = tmp_path / f"jaxscan-{os.getuid()}"
    assert cache_folder() == folder and folder.stat().st_mode & 0o077 == 0
    folder.chmod(0o770)
    assert cache_folder() is None
    folder.rmdir()
    folder.symlink_to(tmp_path)
    assert cache_folder() is None


@pytest.mark.rig
def test_what_libraries_say_comes_as_one_line(tmp_path):
    code = (
        "import logging, sys, warnings; from jaxscan.cli import running\n"
        "def work(words):\n"
        f"    warnings.warn({EVIL!r}); logging.getLogger('lib').warning({EVIL!r})\n"
        "    import threading; t = threading.Thread(target=lambda: 1 / 0); t.start(); t.join()\n"
        "    class Bad:\n        def __del__(self): raise ValueError('late')\n"
        "    Bad(); return 0\n"
        "running.run_function = work; sys.exit(running.run_process([]))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    lines = ran.stderr.splitlines()
    assert ran.returncode == 0 and len(lines) == 4
    assert all(line.startswith("jaxscan: ") and line.isprintable() for line in lines)
    assert lines[0].startswith("jaxscan: note: UserWarning: a\\x1b]52")


def test_warnings_of_the_caller_are_left_alone(run):
    before = warnings.showwarning
    run("measure", "room", "none.ply")
    assert warnings.showwarning is before
