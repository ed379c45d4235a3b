"""`jaxscan view`: clouds in a browser."""

import os
import signal
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from jaxscan.cli.measure import calibrated, notes_first, upright
from jaxscan.cli.options import CloudUnit, CloudUp, OptionalCalibrationPath
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import calibration_at, check_paths, file_at
from jaxscan.errors import CloudError, DependencyError


PORT = 8643


def view(
    clouds: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CLOUD")],
    /,
    *,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
    host: str = "127.0.0.1",
    web_port: int = PORT,
    open: bool = True,
    json: JsonTarget = None,
) -> None:
    """Look around in clouds: `jaxscan view room.ply -c calibration.json`.

    Opens a page in the browser: drag to turn, click to measure. Ctrl-C ends it.

    Args:
        clouds: One or more clouds, to be shown in one place or side by side.
        calibration: Calibration that the clouds were made with; sigma then includes the calibration's part.
        host: Name or number of this machine at which the page is served. Other machines need the token that is printed.
        web_port: TCP port of the page; 0 for any that is free.
        open: Open the browser of this machine, where it has a screen.
        json: Write the address, without its token, as JSON too.
    """
    try:
        import aiohttp as aiohttp
    except ImportError as problem:
        raise DependencyError("The viewer needs aiohttp; type: pip install 'jaxscan[console]'") from problem
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.viewer import Named, serve_clouds
    from jaxscan.web import open_address

    check_paths(
        [*(place for path in clouds for place in file_at("CLOUD", path)), *calibration_at("--calibration", calibration)],
        file_at("--json", json),
    )
    check_json(json)
    if not clouds:
        raise CloudError("name one cloud or more: jaxscan view room.ply")
    scanner, notes = calibrated(calibration)
    named = []
    for path in clouds:
        cloud, said = upright(path, unit, up)
        if not np.any(np.asarray(cloud.valid)):
            raise CloudError(f"{path}: has no points; nothing can be shown.")
        notes += said
        named.append(Named(str(path), cloud, turned=up not in (None, "z") or any("is taken for it" in s for s in said)))
    out = notes_first(notes, json)
    address = open_address(host, web_port, option="--web-port")
    with serve_clouds(address, named, scanner):
        url = address.url(with_token=True)
        out.print(f"Open this address in a browser: {url}")
        out.print("Ctrl-C ends it.")
        emit_json(json, "view", {"url": address.url(), "notes": notes})
        if open and _has_screen():
            webbrowser.open(url)
        signal.pause() if hasattr(signal, "pause") else input()


def _has_screen() -> bool:
    """Whether a browser here would be seen; over SSH it would open in the terminal, or far away."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
