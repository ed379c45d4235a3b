"""`jaxscan <verb>`: one file per verb, joined here.

Exit codes: 0; 1 bad input or a failed verdict; 2 usage; 130 interrupted.
"""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import tyro

from jaxscan.cli.calibrate import calibrate
from jaxscan.cli.convert import convert
from jaxscan.cli.demo import demo
from jaxscan.cli.doctor import doctor
from jaxscan.cli.measure import MEASURES, measure
from jaxscan.cli.reconstruct import reconstruct
from jaxscan.cli.report import report
from jaxscan.cli.scanning.scan import scan
from jaxscan.cli.simulate import simulate
from jaxscan.errors import JaxscanError


VERBS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "simulate": simulate,
    "calibrate": calibrate,
    "reconstruct": reconstruct,
    "scan": scan,
    "measure": measure,
    "convert": convert,
    "report": report,
    "doctor": doctor,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; errors of the input take one line."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    _keep_compiled_code()
    prog, verbs = "jaxscan", VERBS
    if words[:1] == ["measure"]:
        prog, verbs, words = "jaxscan measure", MEASURES, words[1:]
    try:
        tyro.extras.subcommand_cli_from_dict(
            verbs,
            prog=prog,
            description="A camera, a line laser and a turntable as a precise 3D scanner for rooms.",
            args=words,
        )
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


def _keep_compiled_code() -> None:
    """Compile once per machine, not once per run."""
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan" / "compiled"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


if __name__ == "__main__":
    sys.exit(main())
