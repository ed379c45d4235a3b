"""A stopped capture that a stranger has changed is continued, or refused in one line; nothing else is written.

Structured mutations of header, journal, images, lock and folders, each continued on a rig on paper.
"""

import contextlib
import itertools
import os
import random
import shutil
import signal

import pytest

from jaxscan.errors import JaxscanError

from ..fuzz.texts import change_bytes, change_journal, change_toml
from .desk import Desk


STEPS, DONE = 6, 3
NAMES = "capture.toml", "frames.jsonl", ".scan.lock", "on", "off", "on/000001.zst", "off/000002.zst", "on/000004.zst"
PARTS = ".part-0123456789ab.zst", "on/.part-0123456789ab.zst", ".part-x"
EVENTS = ("home", "good"), ("suspect", "records"), ("placed", "placement"), ("end", "status"), ("compared", "good")

VALUES = "null", "-1", "1e999", '"\\u001b[2J"', "[[0, 1e300]]", "[[1]]", "{}", "[]", "9" * 80, "true"


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A sweep that the operator stopped."""
    folder = tmp_path_factory.mktemp("stopped") / "room"
    desk, count = Desk(sweep={"steps": STEPS, "turn_deg": 36.0}), itertools.count()
    result = desk.sweep(folder, should_stop=lambda: next(count) >= DONE)
    assert (result.status, result.records) == ("interrupted", DONE)
    return folder


def own(path):
    """A path that is no link, so that these tests themselves write nowhere else."""
    if path.is_symlink() or path.parent.is_symlink():
        raise OSError(f"{path} is a link")
    return path


def changed(rng, folder, victim):
    """Change the capture in a folder; `victim` is a file outside of it. Returns what was done."""
    kind = rng.choice(("journal", "journal", "header", "header", "event", "place", "place", "bytes"))
    if kind == "journal":
        path = own(folder / "frames.jsonl")
        path.write_bytes(change_journal(rng, path.read_bytes()))
        return kind
    if kind == "header":
        path = own(folder / "capture.toml")
        path.write_bytes(change_toml(rng, path.read_bytes()))
        return kind
    if kind == "event":
        name, key = rng.choice(EVENTS)
        value = rng.choice(VALUES)
        with open(own(folder / "frames.jsonl"), "ab") as file:
            file.write(f'{{"event": "{name}", "{key}": {value}}}\n'.encode())
        return f"{kind} {name} {key} {value}"
    if kind == "bytes":
        name = rng.choice([one for one in NAMES if (folder / one).is_file() and own(folder / one)])
        (folder / name).write_bytes(change_bytes(rng, (folder / name).read_bytes()))
        return f"{kind} {name}"
    name = rng.choice(NAMES + PARTS)
    what = rng.choice(("link", "link", "dangling", "away", "pipe", "folder", "zero", "loop", "gone"))
    path = folder / name
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    match what:
        case "link":
            path.symlink_to(victim)
        case "dangling":
            path.symlink_to(victim.parent / "made")
        case "away":
            path.symlink_to(victim.parent)
        case "pipe":
            os.mkfifo(path)
        case "folder":
            (path / "within").mkdir(parents=True)
        case "zero":
            path.symlink_to("/dev/zero")
        case "loop":
            path.symlink_to(path)
    return f"{kind} {name} {what}"


class Hang(BaseException):
    """A resumption that does not end."""


def _hang(*_):
    raise Hang


def tried(stopped, tmp_path, rng):
    """Change a copy, continue it, and check what came of it. Returns "complete", "refused" or another status."""
    outside = tmp_path / "outside"
    shutil.rmtree(tmp_path / "inside", ignore_errors=True)
    shutil.rmtree(outside, ignore_errors=True)
    outside.mkdir(parents=True)
    victim = outside / "victim"
    victim.write_bytes(b"precious")
    folder = tmp_path / "inside" / "room"
    shutil.copytree(stopped, folder)
    done = []
    for _ in range(rng.choice((1, 1, 2))):
        # What was put in a file's place cannot be changed itself.
        with contextlib.suppress(OSError, ValueError):
            done.append(changed(rng, folder, victim))
    desk = Desk(sweep={"steps": STEPS, "turn_deg": 36.0})
    before = signal.signal(signal.SIGALRM, _hang)
    signal.alarm(30)
    try:
        verdict = desk.sweep(folder, resume=True).status
    except JaxscanError as problem:
        verdict = "refused"
        assert len(str(problem)) < 2000, (done, str(problem)[:300], str(problem)[-200:])
        assert "\n" not in str(problem), (done, str(problem))
    except BaseException as problem:
        raise AssertionError(f"{done}: {type(problem).__name__}: {str(problem)[:300]}") from problem
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert sorted(one.name for one in outside.iterdir()) == ["victim"], done
    assert victim.read_bytes() == b"precious", done
    assert sorted(one.name for one in folder.parent.iterdir()) == ["room"], done
    assert not desk.table.laser and not desk.table.contactor, done
    return verdict


@pytest.mark.parametrize(
    ("count", "seed"),
    [(40, 1), *(pytest.param(100, seed, marks=[pytest.mark.slow, pytest.mark.timeout(900)]) for seed in (2, 3, 4))],
)
def test_a_stopped_scan_that_somebody_changed(stopped, tmp_path, count, seed):
    rng = random.Random(seed)
    verdicts = [tried(stopped, tmp_path, rng) for _ in range(count)]
    assert verdicts.count("complete") > 0 and verdicts.count("refused") > 0, verdicts
