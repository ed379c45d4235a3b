"""`jaxscan <verb>`: one file per verb, imported when the verb is called.

Exit codes: 0; 1 bad input or a failed verdict; 2 usage; 130 interrupted.
"""

import functools
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tyro

from jaxscan.errors import JaxscanError


DESCRIPTION = "A camera, a line laser and a turntable as a precise 3D scanner for rooms."
VERBS = {
    "demo": "Calibrate, scan, reconstruct and measure a simulated room: `jaxscan demo`.",
    "simulate": "Render a simulated rig: `jaxscan simulate configs/paper.toml -o captures/paper --every 10`.",
    "calibrate": "Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.",
    "reconstruct": "Reconstruct a sweep: `jaxscan reconstruct captures/room -c calibration.json -o room.ply`.",
    "scan": "Scan with a rig: `jaxscan scan configs/scan.toml -o captures/room`.",
    "measure": "Measure a cloud: room, distance, plane or compare (`jaxscan measure room --help`).",
    "convert": "Convert a cloud, a calibration or a capture: `jaxscan convert room.ply room.e57`.",
    "report": "Draw a calibration's report: `jaxscan report calibration.json -o report.html`.",
    "doctor": "Check this machine: `jaxscan doctor`. A rig: `jaxscan doctor --config configs/scan.toml`.",
}
"""The first line of each verb's docstring, for the list of verbs: it is shown without loading any verb."""
MEASURES = {
    "room": "Wall to wall: `jaxscan measure room room.ply -c calibration.json`.",
    "distance": "Between two picked points: `jaxscan measure distance room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.",
    "plane": "Flatness around a point: `jaxscan measure plane room.ply --at 1.9 0.2 0.1`.",
    "compare": "Against a true or better cloud: `jaxscan measure compare room.ply truth.npz`.",
}
"""The same for the verbs below `jaxscan measure`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; an error of the input is printed as one line."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        _run(words)
    except JaxscanError as error:
        if debug:
            raise
        # Messages of other libraries may have several lines.
        print("jaxscan:", *str(error).split(), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if debug:
            raise
        print("jaxscan: interrupted", file=sys.stderr)
        return 130
    return 0


def load_verb(verb: str) -> Callable[..., None]:
    """The function of a verb; its module is imported now."""
    module = "measure" if verb in MEASURES else "scanning.scan" if verb == "scan" else verb
    function: Callable[..., None] = getattr(importlib.import_module(f"jaxscan.cli.{module}"), verb)
    return function


def _run(words: list[str]) -> None:
    prog, verbs = "jaxscan", VERBS
    if words[:1] == ["measure"]:
        prog, verbs, words = "jaxscan measure", MEASURES, words[1:]
    if not words or words[0] not in verbs:
        # A request for help, or a mistake that is answered with the closest verb: either ends here.
        listed = {name: _listed(line) for name, line in verbs.items()}
        tyro.extras.subcommand_cli_from_dict(listed, prog=prog, description=DESCRIPTION, args=words)
        return
    verb, *rest = words
    function = load_verb(verb)

    @functools.wraps(function)
    def run_verb(*positional: Any, **options: Any) -> None:
        _keep_compiled_code()
        function(*positional, **options)

    tyro.cli(run_verb, prog=f"{prog} {verb}", args=rest)


def _listed(line: str) -> Callable[[], None]:
    """A verb as the list of verbs shows it."""
    verb: Callable[[], None] = lambda: None
    verb.__doc__ = line
    return verb


def _keep_compiled_code() -> None:
    """Let JAX keep compiled code on the disk: it compiles once per machine, not once per run."""
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan" / "compiled"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    # Imported here, so that `--help` does not load JAX.
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


if __name__ == "__main__":
    sys.exit(main())
