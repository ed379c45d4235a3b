"""The tables and figures of the paper, and experiments beyond it.

    python -m experiments.paper [NAME …] [--world kind|unkind] [--quick] [--out FOLDER] [--save-baseline]

Every experiment prints its figures, which are compared with the committed baseline, and figures 5 to 9 draw a picture.
Without a name all run; without a world both, each in a process of its own, and then the page of results is written.
`--quick` takes small images and few draws, to see that all of it works, and prints the page. Work files are kept in
FOLDER/work: those that are there are not made again; `--fresh` removes them first.
"""

import argparse
import importlib
import json
import os
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import jax

from experiments.paper.page import PAGE, page
from experiments.paper.stage import (
    EXPERIMENTS,
    WORLDS,
    Metric,
    Stage,
    line,
    load_baseline,
    part_of,
    results_path,
    save_baseline,
    shown,
    world,
)
from experiments.report import command_line


def run_one(stage: Stage, name: str) -> dict[str, Any]:
    """Run an experiment, print its figures, and return them with its run time."""
    started = time.perf_counter()
    metrics: list[Metric] = importlib.import_module(f"experiments.paper.{name}").run(stage)
    seconds = time.perf_counter() - started
    print(f"\n{name}, {stage.world} world ({seconds:.0f} s)", flush=True)
    baseline = load_baseline(part_of(stage.world, stage.quick))
    worse = []
    for metric in metrics:
        known = baseline.get(f"{name}.{metric.key}")
        was = "" if known is None else f", baseline {shown(known[0])} ± {known[1]:.2g}"
        if known is not None and metric.worse_than(*known):
            worse.append(metric.key)
            was += " WORSE"
        print(line(metric) + was, flush=True)
    return {"seconds": seconds, "worse": worse, "metrics": [metric._asdict() for metric in metrics]}


def keep_compiled(folder: Path) -> None:
    """Keep compiled code for the next run, and share it between both worlds, unless the environment says where."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def run_world(name: str, chosen: list[str], options: argparse.Namespace) -> int:
    """Experiments of one world; their figures are written as each ends."""
    folder = options.out / "work" / part_of(name, options.quick).replace(" ", "_")
    stage = Stage(name, world(name, quick=options.quick), folder, options.out, options.quick)
    path = results_path(options.out, name, options.quick)
    if options.fresh:
        shutil.rmtree(folder, ignore_errors=True)
    keep_compiled(options.out / "work" / "compiled")
    path.parent.mkdir(parents=True, exist_ok=True)
    done = json.loads(path.read_text()) if path.exists() else {}
    failed = False
    for each in chosen:
        done.pop(each, None)
        try:
            done[each] = run_one(stage, each)
        except Exception:
            # The other experiments still run.
            traceback.print_exc()
            failed = True
            continue
        path.write_text(json.dumps(done, indent=1) + "\n")
        if options.save_baseline:
            save_baseline(part_of(name, options.quick), each, metrics_of(done[each]))
    missed = [f"{each}.{one.key}" for each in chosen for one in metrics_of(done.get(each)) if not one.met()]
    if missed:
        print(f"\n{name} world, limits that are missed: {', '.join(missed)}")
    return int(failed or any(done[each]["worse"] for each in chosen))


def metrics_of(results: dict[str, Any] | None) -> list[Metric]:
    """The figures of an experiment, from its part of the file of results."""
    return [] if results is None else [Metric(**fields) for fields in results["metrics"]]


def main() -> int:
    """The command."""
    parser = command_line(__doc__, quick="small images and few draws, to see that all of it works")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(EXPERIMENTS))
    parser.add_argument("--world", choices=WORLDS)
    parser.add_argument("--out", type=Path, default=Path("paper-figures"), metavar="FOLDER")
    parser.add_argument("--fresh", action="store_true", help="remove work files of earlier runs first")
    parser.add_argument("--save-baseline", action="store_true", help="replace the committed baseline by these figures")
    options = parser.parse_args()
    if strange := set(options.names) - set(EXPERIMENTS):
        parser.error(f"no such experiment: {', '.join(sorted(strange))}; there are {', '.join(EXPERIMENTS)}")
    chosen = [name for name in EXPERIMENTS if name in options.names or not options.names]
    if options.world:
        return run_world(options.world, chosen, options)
    command = [sys.executable, "-m", "experiments.paper", *sys.argv[1:], "--world"]
    running = [subprocess.Popen([*command, name]) for name in WORLDS]
    code = max(process.wait() for process in running)
    paths = {name: results_path(options.out, name, options.quick) for name in WORLDS}
    text = page({name: json.loads(path.read_text()) for name, path in paths.items() if path.exists()})
    if options.quick:
        print(text)
    else:
        PAGE.write_text(text)
    return code


if __name__ == "__main__":
    sys.exit(main())
