"""`jaxscan batch`: makes what a project lacks, on this machine or on a cluster."""

import importlib.util
import logging
import shlex
import time
from collections.abc import Sized
from pathlib import Path
from typing import Any

from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.cli.process.terminal import Terminal
from jaxscan.cli.project.plan import Opened, ProjectPath, counted, in_words, opened
from jaxscan.errors import DependencyError, FleetError


def batch(
    project: ProjectPath = Path("project.toml"),
    /,
    *,
    cluster: str | None = None,
    slurm: bool = False,
    kubernetes: bool = False,
    ssh: Path | None = None,
    workers: int | None = None,
    memory_gib: float | None = None,
    tls: Path | None = None,
    output: Path | None = None,
    json: JsonTarget = None,
) -> None:
    """Make what a project lacks: `jaxscan batch project.toml`.

    What is missing or stale is made, and nothing else, on the cores of this machine or on a Dask cluster. A capture
    that fails is said in a line and stops no other; then the exit code is 1. Ended in the middle and called again, it
    goes on where it was.

    Args:
        project: The project's file.
        cluster: Address of a Dask scheduler that runs already: tcp://host:port or tls://host:port.
        slurm: Take workers from SLURM, as Dask's configuration says.
        kubernetes: Take workers from Kubernetes, as Dask's configuration says.
        ssh: File with a host on each line, on which workers are started by SSH.
        workers: How many workers; without, one for each core of this machine, as far as memory reaches.
        memory_gib: Memory of each worker [GiB].
        tls: Folder with ca.pem, cert.pem and key.pem, for --cluster tls://host:port.
        output: Folder of the products, as the project's file has it: needed once where that lies outside of the
            project's folder.
        json: Write the result as JSON too.
    """
    check_paths([*file_at("PROJECT", project), *file_at("--ssh", ssh)], file_at("--json", json))
    check_json(json)
    _need_dask()
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.fleet import ClusterChoice, check_choice
    from jaxscan.project import claimed, load_project

    choice = ClusterChoice(cluster, workers, memory_gib, slurm=slurm, kubernetes=kubernetes, ssh=ssh, tls=tls)
    check_choice(choice)
    out, start = console(json), time.perf_counter()
    wanted = load_project(project)
    with claimed(wanted, output), opened(wanted, write=True) as found:
        counts = counted(found.states)
        out.print(f"{_many(found.project.captures, 'capture')}, {_many(found.states, 'step')}: {in_words(counts)}")
        for note in wanted.notes:
            out.print(f"note: {note}")
        result: dict[str, Any] = {"done": [], "failed": {}, "not_begun": {}, "notes": {}}
        if counts["done"] < len(found.states):
            result = _work(found, choice, out)
    seconds = time.perf_counter() - start
    if result["done"]:
        out.print(f"{_many(result['done'], 'step')} done in {seconds:.0f} s, in {found.project.output}")
    if result["notes"]:
        told = shlex.join(["jaxscan", "project", "status", "--all", str(project)])
        out.print(f"notes on {_many(result['notes'], 'step')}: {told}")
    about = {"output": str(found.project.output), "seconds_s": seconds, "left_out": list(wanted.notes)}
    emit_json(json, "batch", result | about)
    if result["failed"]:
        failed, behind = _many(result["failed"], "step"), _many(result["not_begun"], "step")
        again = shlex.join(["jaxscan", "batch", str(project)])
        raise FleetError(f"{failed} failed, {behind} behind not begun; mend what failed and call again: {again}")


def _many(listed: Sized, name: str) -> str:
    return f"{len(listed)} {name}{'' if len(listed) == 1 else 's'}"


def _work(found: Opened, choice: Any, out: Terminal) -> dict[str, Any]:
    from jaxscan.cli.project.display import batch_display
    from jaxscan.fleet import open_cluster, patience_of
    from jaxscan.fleet.batch import check_sight, run_batch
    from jaxscan.project import order_of

    # Errors of the cluster are said in one line; Dask would say them in many.
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    output = found.project.output
    todo = [order_of(status, output) for status in found.states if status.state != "done"]
    with open_cluster(choice) as client, batch_display(out, len(todo)) as display:
        check_sight(client, output)
        report = run_batch(todo, found.catalogue, client, display, patience_s=patience_of(choice))
    return {
        "done": [row.key for row in report.rows if row.state == "done"],
        "failed": {row.key: row.message for row in report.failed},
        "not_begun": dict(report.left),
        "notes": {row.key: row.message for row in report.rows if row.state == "done" and row.message},
    }


def _need_dask() -> None:
    if importlib.util.find_spec("distributed") is None:
        raise DependencyError('a batch needs Dask: pip install "jaxscan[fleet]".')
