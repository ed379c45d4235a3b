"""A process that runs cases one after the other, and says of each what it found, as a line of JSON."""

import contextlib
import json
import os
import shutil
import sys
import time
from pathlib import Path

from .cases import OUT, make_case
from .judge import changes, snapshot, verdict


def main(corpus: Path, work: Path) -> None:
    """Read lines `seed number` from standard input until it ends; answer each on standard output."""
    questions, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    out, err = _captured(work / "stdout", 1), _captured(work / "stderr", 2)
    for asked, question in enumerate(questions, 1):
        seed, number = map(int, question.split())
        answer = {"asked": asked, **_answer(seed, number, corpus, work / "case", (out, err))}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _captured(path: Path, descriptor: int) -> int:
    """Send a descriptor of this process to a file, so that the lines of C libraries are seen too."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(file, descriptor)
    return file


def _answer(seed: int, number: int, corpus: Path, folder: Path, files: tuple[int, int]) -> dict:
    shutil.rmtree(folder, ignore_errors=True)
    case = make_case(seed, number, corpus, folder)
    before = snapshot(folder)
    for file in files:
        os.ftruncate(file, 0)
    _forget_peak()
    start = time.perf_counter()
    os.chdir(folder)
    code = _run(case.words)
    seconds, peak = time.perf_counter() - start, _memory("VmHWM:")
    sys.stdout.flush()
    sys.stderr.flush()
    out, err = (os.pread(file, 1 << 24, 0) for file in files)
    # Where the result goes to standard output, everything for people goes to standard error.
    last = b"".join(err.splitlines(keepends=True)[-1:] if code else [])
    faults = verdict(code, out, last if "-" in case.words else err, seconds, peak)
    # A calibration that is refused is written all the same, and says so.
    written = code == 0 or b": written, but" in err
    left = changes(before, snapshot(folder), case.kept | (case.outputs if written else set()))
    # An output that was asked for under a strange name, perhaps in the working folder.
    asked = (OUT + "/", *(f"{word}: nothing" for word in case.words))
    left = [one for one in left if not (written and one.startswith(asked) and ".part" not in one)]
    faults += ["changed"] if left else []
    answer = {
        "seed": seed,
        "number": number,
        "kind": case.kind,
        "words": case.words,
        "code": code,
        "seconds": seconds,
        "peak": peak,
        "resting": _memory("VmRSS:"),
        "faults": faults,
        "left": left[:5],
        "noted": b"note:" in out + err,
        "err": err.decode("utf-8", "backslashreplace")[:2000],
        "out": out.decode("utf-8", "backslashreplace")[-1000:],
    }
    if case.cloud is not None and code == 0:
        answer |= _difference(folder / case.cloud, corpus / "cloud.npz")
    return answer


def _run(words: list[str]) -> int | None:
    """The exit code; None where an exception comes out."""
    from jaxscan.cli.main import main

    try:
        return main(words)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        import traceback

        traceback.print_exc()
        return None


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
