"""`jaxscan <verb>`: one file per verb, imported when the verb is called.

Exit codes: 0; 1 bad input or a failed verdict; 2 usage; 130 interrupted.
"""

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import tyro

from jaxscan.errors import JaxscanError


DESCRIPTION = "A camera, a line laser and a turntable as a precise 3D scanner for rooms."
VERBS = {
    "demo": ("jaxscan.cli.demo", "Calibrate, scan, reconstruct and measure a simulated room: `jaxscan demo`."),
    "simulate": (
        "jaxscan.cli.simulate",
        "Render a simulated rig: `jaxscan simulate configs/paper.toml -o captures/paper --every 10`.",
    ),
    "calibrate": (
        "jaxscan.cli.calibrate",
        "Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.",
    ),
    "reconstruct": (
        "jaxscan.cli.reconstruct",
        "Reconstruct a sweep: `jaxscan reconstruct captures/room -c calibration.json -o room.ply`.",
    ),
    "scan": (
        "jaxscan.cli.scanning.scan",
        "Scan with a rig: `jaxscan scan configs/scan.toml -o captures/room`.",
    ),
    "measure": (
        "jaxscan.cli.measure",
        "Measure a cloud: room, distance, plane or compare (`jaxscan measure room --help`).",
    ),
    "convert": (
        "jaxscan.cli.convert",
        "Convert a cloud, a calibration or a capture: `jaxscan convert room.ply room.e57`.",
    ),
    "report": (
        "jaxscan.cli.report",
        "Draw a calibration's report: `jaxscan report calibration.json -o report.html`.",
    ),
    "doctor": (
        "jaxscan.cli.doctor",
        "Check this machine: `jaxscan doctor`. A rig: `jaxscan doctor --config configs/scan.toml`.",
    ),
}
"""Of each verb the module, whose function has the verb's name, and the first line of its docstring."""
MEASURES = {
    "room": ("jaxscan.cli.measure", "Wall to wall: `jaxscan measure room room.ply -c calibration.json`."),
    "distance": (
        "jaxscan.cli.measure",
        "Between two picked points: `jaxscan measure distance room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.",
    ),
    "plane": (
        "jaxscan.cli.measure",
        "Flatness round a point: `jaxscan measure plane room.ply --at 1.9 0.2 0.1`.",
    ),
    "compare": (
        "jaxscan.cli.measure",
        "Against a true or better cloud: `jaxscan measure compare room.ply truth.npz`.",
    ),
}
"""The same of the verbs below `jaxscan measure`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; errors of the input take one line."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        _run(words)
    except JaxscanError as error:
        if debug:
            raise
        # Foreign libraries explain themselves in several lines.
        print("jaxscan:", *str(error).split(), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if debug:
            raise
        print("jaxscan: interrupted", file=sys.stderr)
        return 130
    return 0


def _run(words: list[str]) -> None:
    prog, verbs = "jaxscan", VERBS
    if words[:1] == ["measure"]:
        prog, verbs, words = "jaxscan measure", MEASURES, words[1:]
    if not words or words[0] not in verbs:
        # A request for help, or a mistake that is answered with the closest verb: either ends here.
        verbs_to_list = {name: _listed(line) for name, (_, line) in verbs.items()}
        tyro.extras.subcommand_cli_from_dict(verbs_to_list, prog=prog, description=DESCRIPTION, args=words)
        return
    verb, *rest = words
    function = getattr(importlib.import_module(verbs[verb][0]), verb)
    _keep_compiled_code()
    tyro.cli(function, prog=f"{prog} {verb}", args=rest)


def _listed(line: str) -> Callable[[], None]:
    """A verb as the list of verbs shows it."""

    def verb() -> None:
        pass

    verb.__doc__ = line
    return verb


def _keep_compiled_code() -> None:
    """Compile once per machine, not once per run."""
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan" / "compiled"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    # Here, so that `jaxscan --help` does not load JAX.
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


if __name__ == "__main__":
    sys.exit(main())
