"""Runs many cases in processes of their own, which are replaced when they hang, die, or grow."""

import json
import os
import queue
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from .judge import MAX_SECONDS


ROOT = Path(__file__).resolve().parents[2]
_PATIENCE = MAX_SECONDS + 90.0
"""A fresh process also loads libraries and compiles; the time of a case is taken inside."""

_RESTING_BYTES = 1_300_000_000
"""Memory with which a process is replaced; after a first case it has about a third of it."""


def run_cases(
    cases: Iterable[tuple[int, int]], corpus: Path, *, processes: int = 2, tell: Callable[[dict], None] | None = None
) -> list[dict[str, Any]]:
    """Run cases (seed, number); the answers, in any order."""
    todo: queue.SimpleQueue[tuple[int, int] | None] = queue.SimpleQueue()
    for case in cases:
        todo.put(case)
    for _ in range(processes):
        todo.put(None)
    answers: list[dict[str, Any]] = []

    def work() -> None:
        with tempfile.TemporaryDirectory(prefix="jaxscan-fuzz-", ignore_cleanup_errors=True) as folder:
            worker = None
            while (case := todo.get()) is not None:
                worker = worker or _start(corpus, Path(folder))
                answer, worker = _ask(worker, case, Path(folder))
                if "memory" in answer["faults"] and answer["asked"] > 1:
                    # What earlier cases compiled stays in memory; a verb has a process of its own.
                    worker = _start(corpus, Path(folder))
                    answer, worker = _ask(worker, case, Path(folder))
                answers.append(answer)
                if tell is not None:
                    tell(answer)
            if worker is not None:
                _stop(worker)

    threads = [threading.Thread(target=work) for _ in range(processes)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


def _start(corpus: Path, folder: Path) -> subprocess.Popen:
    # A process that follows another finds all that was compiled.
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "hardware")]),
        "NO_COLOR": "1",
        "JAX_COMPILATION_CACHE_DIR": str(corpus.with_name(corpus.name + "-compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "XDG_CACHE_HOME": str(corpus.with_name(corpus.name + "-compiled")),
    }
    command = [sys.executable, "-m", "tests.fuzz.worker", str(corpus), str(folder)]
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )


def _ask(
    worker: subprocess.Popen, case: tuple[int, int], folder: Path
) -> tuple[dict[str, Any], subprocess.Popen | None]:
    """The answer to one case, and the process if it goes on."""
    assert worker.stdin is not None and worker.stdout is not None
    worker.stdin.write(f"{case[0]} {case[1]}\n".encode())
    worker.stdin.flush()
    ready, _, _ = select.select([worker.stdout], [], [], _PATIENCE)
    line = worker.stdout.readline() if ready else b""
    if line:
        answer = json.loads(line)
        if answer["resting"] > _RESTING_BYTES or "memory" in answer["faults"]:
            _stop(worker)
            return answer, None
        return answer, worker
    code = worker.wait() if ready else None
    # Ended by the system for the processor's time that it took, or silent.
    fault = "crash" if ready and code != -signal.SIGXCPU else "hang"
    _stop(worker)
    said = (folder / "stderr").read_text("utf-8", "backslashreplace")[-2000:]
    answer = {"seed": case[0], "number": case[1], "kind": "?", "faults": [fault], "asked": 1, "code": code, "err": said}
    return answer, None


def _stop(worker: subprocess.Popen) -> None:
    with worker:
        worker.kill()


def counts(answers: Iterable[dict[str, Any]]) -> Counter[str]:
    """How many cases had each fault, each exit code, and a cloud that differs without a word."""
    found: Counter[str] = Counter()
    for answer in answers:
        found["cases"] += 1
        found[f"exit {answer['code']}"] += 1
        found.update(answer["faults"])
        if answer.get("differs"):
            kind = "sealed" if "unsealed" not in answer["kind"] else "unsealed"
            found[f"different cloud, {kind}"] += 1
            found[f"different cloud, {kind}, without a word"] += not answer["noted"]
    return found
