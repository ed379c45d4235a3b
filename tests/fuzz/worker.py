"""A process that runs cases one after the other, and says of each what it found, as a line of JSON."""

import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from pathlib import Path

from .cases import OUT, Case, make_case
from .draft import SECRET
from .hardship import hardship
from .judge import MAX_SECONDS, changes, snapshot, verdict
from .watch import Watch


def main(corpus: Path, work: Path) -> None:
    """Read lines `seed number` from standard input until it ends; answer each on standard output."""
    questions, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    out, err = _captured(work / "stdout", 1), _captured(work / "stderr", 2)
    watch = _prepare(corpus, work)
    for asked, question in enumerate(questions, 1):
        seed, number = map(int, question.split())
        answer = {"asked": asked, **_answer(seed, number, corpus, work / "case", (out, err), watch)}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _prepare(corpus: Path, work: Path) -> Watch:
    """Make this process like that of the command line, but for pages, which would be served for ever."""
    from jaxscan.cli.environment import hush_libraries, one_thread_per_product
    from jaxscan.cli.running import _keep_to_lines

    # Compiled modules would be written beside the sources, outside of the case.
    sys.dont_write_bytecode = True
    for name in ("tmp", "home"):
        (work / name).mkdir(exist_ok=True)
    os.environ |= {"TMPDIR": str(work / "tmp"), "HOME": str(work / "home")}
    hush_libraries()
    one_thread_per_product()
    _keep_to_lines()
    # It asks on import whether this machine has IPv6.
    with contextlib.suppress(ImportError):
        import urllib3  # noqa: F401
    # It asks another program for the fonts of the machine, once.
    import matplotlib.font_manager  # noqa: F401

    from jaxscan.cli.console.desk import Desk

    # Pages are served until these return.
    signal.pause = lambda: None  # type: ignore[assignment]
    Desk.attend = lambda self: None  # type: ignore[method-assign]
    # A file that asks for all memory ends this process, not the machine.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (8 << 30, hard))
    return Watch((corpus.with_name(corpus.name + "-compiled"), work / "tmp", work / "home"))


def _captured(path: Path, descriptor: int) -> int:
    """Send a descriptor of this process to a file, so that the lines of C libraries are seen too."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(file, descriptor)
    return file


def _answer(seed: int, number: int, corpus: Path, folder: Path, files: tuple[int, int], watch: Watch) -> dict:
    shutil.rmtree(folder, ignore_errors=True)
    case = make_case(seed, number, corpus, folder)
    before = snapshot(folder)
    for file in files:
        os.ftruncate(file, 0)
    _forget_peak()
    os.chdir(folder)
    start, wall = time.process_time(), time.perf_counter()
    _limit_time(start)
    with watch.watching(folder) as asked, hardship(case.most_bytes, case.read_only):
        code, faults = _run(case)
    # The processor's time: others work on this machine too. Of a case that waits, that of the clock.
    seconds, waited, peak = time.process_time() - start, time.perf_counter() - wall, _memory("VmHWM:")
    sys.stdout.flush()
    sys.stderr.flush()
    out, err = (os.pread(file, 1 << 24, 0) for file in files)
    # Where the result goes to standard output, everything for people goes to standard error.
    last = b"".join(err.splitlines(keepends=True)[-1:] if code else [])
    faults += verdict(code, out, last if "-" in case.words else err, max(seconds, waited / 4), peak)
    faults += sorted(asked.keys() - case.allowed)
    # A calibration that is refused is written all the same, and says so.
    written = code == 0 or b": written, but" in err
    after = snapshot(folder)
    left = changes(before, after, case.kept | (case.outputs if written else set()))
    # An output that was asked for under a strange name, perhaps in the working folder.
    given = (OUT + "/", *(f"{word}: nothing" for word in case.words))
    left = [one for one in left if not (written and one.startswith(given) and ".part" not in one)]
    left += [f"temporary folder: {one}" for one in _emptied(folder.parent / "tmp")]
    faults += ["changed"] if left else []
    noted = b"note:" in out + err
    answer = {
        "seed": seed,
        "number": number,
        "kind": case.kind,
        "words": case.words,
        "code": code,
        "seconds": seconds,
        "peak": peak,
        "resting": _memory("VmRSS:"),
        "left": left[:5],
        "asked of": {kind: sorted(what)[:5] for kind, what in asked.items()},
        "noted": noted,
        "err": err.decode("utf-8", "backslashreplace")[:2000],
        "out": out.decode("utf-8", "backslashreplace")[-1000:],
    }
    if case.cloud is not None and code == 0:
        answer |= _difference(folder / case.cloud, corpus / "cloud.npz")
    silent = code == 0 and not noted
    if silent and (case.needs_word or (answer.get("differs") and "unsealed" not in case.kind)):
        faults += ["silent"]
    # An error may quote what a file that was named holds; a result may not.
    if SECRET.encode() in out or _repeats(folder, before, after):
        faults += ["leak"]
    return answer | {"faults": faults}


def _limit_time(start: float) -> None:
    """Let the system end this process if a case takes three times what it may; code in C hears nothing else."""
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    # Each core counts.
    resource.setrlimit(resource.RLIMIT_CPU, (int(start + 3 * MAX_SECONDS) + 1, hard))


def _emptied(folder: Path) -> list[str]:
    """What was left in a folder, which is removed."""
    left = sorted(path.name for path in folder.iterdir())
    for name in left:
        if (folder / name).is_dir():
            shutil.rmtree(folder / name, ignore_errors=True)
        else:
            (folder / name).unlink()
    # A folder that stays as long as the process is none that is left behind.
    return [name for name in left if not name.startswith(("matplotlib-", "jaxscan-"))]


def _repeats(folder: Path, before: dict[str, str], after: dict[str, str]) -> bool:
    """Whether a file that was written holds the secret of a file that nobody named."""
    for name, content in after.items():
        if content.startswith("file") and before.get(name) != content:
            with open(folder / name, "rb") as file:
                if SECRET.encode() in file.read(1 << 24):
                    return True
    return False


def _run(case: Case) -> tuple[int | None, list[str]]:
    """The exit code, None where an exception comes out; and the faults that a driver saw."""
    from jaxscan.cli.main import main

    try:
        if case.drive is not None:
            return 0, case.drive()
        return main(case.words), []
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 1, []
    except BaseException:
        import traceback

        traceback.print_exc()
        return None, []


def _difference(cloud: Path, true: Path) -> dict:
    """Whether a profile of a cloud lies more than 3 standard deviations away (median), or has half as many points."""
    import numpy as np

    with contextlib.suppress(OSError, KeyError, ValueError), np.load(cloud) as found, np.load(true) as expected:
        if found["valid"].shape != expected["valid"].shape:
            return {"differs": True}
        both = found["valid"] & expected["valid"]
        sigma = np.hypot(expected["sigma_random"], expected["sigma_systematic"])
        away = np.linalg.norm(found["xyz"].astype(float) - expected["xyz"], axis=-1) / np.where(both, sigma, 1.0)
        ratio = np.where(both, away, np.nan)
        counts = expected["valid"].sum(1)
        lost = np.abs(found["valid"].sum(1) - counts) > 0.5 * counts
        with np.errstate(all="ignore"):
            medians = np.array([np.median(row[~np.isnan(row)]) if (~np.isnan(row)).any() else 0.0 for row in ratio])
        return {"differs": bool((medians > 3).any() or lost.any())}
    return {}


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _memory(name: str) -> int:
    """Memory of this process [bytes]: "VmRSS:", or "VmHWM:", the largest since `_forget_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    return 0


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
