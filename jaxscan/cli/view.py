"""`jaxscan view`: clouds in a browser."""

import os
import shlex
import signal
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from jaxscan import project as projects
from jaxscan.cli.help import Arg
from jaxscan.cli.measure import calibrated
from jaxscan.cli.options import CloudUnit, CloudUp, OptionalCalibrationPath, check_paths, need_pages
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import CaptureError, CloudError, OptionError
from jaxscan.files import clouds as cloud_files
from jaxscan.files import disk


if TYPE_CHECKING:
    from jaxscan.files.clouds import Unit, Up
    from jaxscan.reconstruction import PointCloud
    from jaxscan.viewer import Panorama


HOST, PORT = "127.0.0.1", 8643
MOST_CLOUDS = 24
LARGEST_PICTURE = 200_000_000


def view(
    clouds: Annotated[tuple[Path, ...], Arg("CLOUD")],
    /,
    *,
    calibration: OptionalCalibrationPath = None,
    panorama: Annotated[tuple[Path, ...], Arg("PATH")] = (),
    unit: CloudUnit = None,
    up: CloudUp = None,
    host: str = HOST,
    web_port: int = PORT,
    open: bool = True,
) -> None:
    """Look around in clouds: `jaxscan view room.ply -c calibration.json`.

    Opens a page in the browser: drag to turn, click to measure. Ctrl-C ends it. The JSON holds the address
    without its token.

    Args:
        clouds: One or more clouds, to be shown in one place or side by side; or a project.toml, for the clouds that it
            has and a note on each that it has not.
        calibration: Calibration that the clouds were made with; sigma then includes the calibration's part.
        panorama: Panorama of the first cloud, then that of the second, and so on, to stand in: as `jaxscan panorama`
            makes them, or any equirectangular PNG or JPEG from the scanner's place.
        host: Name or number of this machine at which the page is served. Everybody needs the token of the address that
            is printed.
        web_port: TCP port of the page; 0 for any that is free.
        open: Open the browser of this machine, where it has a screen.
    """
    need_pages("The viewer", "view")
    check_paths({"CLOUD": clouds, "--panorama": panorama, "--calibration": calibration})
    files = [path for path in clouds if path.suffix.lower() == ".toml"]
    clouds, missing = with_projects(clouds)
    if not clouds:
        raise CloudError("name one cloud or more: jaxscan view room.ply")
    if len(panorama) > len(clouds):
        raise OptionError(f"--panorama: found {len(panorama)} pictures for {len(clouds)} clouds; name one for each.")
    scanner, notes = calibrated(calibration)
    read = {path: _read(path, unit, up) for path in clouds}
    notes = [*notes, *missing, *(f"{path}: {note}" for path, one in read.items() for note in one.notes)]
    from jaxscan.viewer import Named, knows_its_place, serve_clouds
    from jaxscan.web import in_browser, open_address

    seen = [_read_panorama(path) for path in panorama]
    given = {"calibration": ("-c", calibration), "unit": ("--unit", unit), "up": ("--up", up)}
    words = {name: f"{key} {shlex.quote(str(value))}" for name, (key, value) in given.items() if value is not None}
    named = []
    for path, picture in zip_longest(clouds, seen):
        one = read[path]
        if picture is not None and not knows_its_place(one.cloud):
            raise OptionError(f"--panorama: {path} does not say where its scanner stood, so nobody can stand there.")
        named.append(Named(str(path), one.cloud, turned=one.turned, panorama=picture, words=words))
    out = console(notes)
    address = open_address(host, web_port, option="--web-port")
    with ExitStack() as stack:
        products = partial(products_of, files) if files else None
        stack.enter_context(serve_clouds(address, named, scanner, products))
        for line in address.invitation():
            out.print(line)
        out.print("Ctrl-C ends it.")
        emit_json({"url": address.url(), "notes": notes})
        if open and _has_screen():
            stack.enter_context(in_browser(address.url(with_token=True)))
        signal.pause() if hasattr(signal, "pause") else input()


class _Read(NamedTuple):
    """A cloud as it was read."""

    cloud: "PointCloud"
    """The cloud in metres, z up."""
    turned: bool
    """Whether its axes are not those of the file."""
    notes: list[str]


def _read(path: Path, unit: "Unit | None", up: "Up | None") -> _Read:
    stored = cloud_files.read_cloud(path)
    metres, said = cloud_files.in_metres(stored, unit)
    cloud, more = cloud_files.with_z_up(stored, metres, up)
    if not np.any(np.asarray(cloud.valid)):
        raise CloudError(f"{path}: has no points; nothing can be shown.")
    return _Read(cloud, cloud is not metres, [*said, *more])


def with_projects(paths: Sequence[Path]) -> tuple[tuple[Path, ...], list[str]]:
    """The clouds of projects in their places, and a note on each that is stale, failed or missing.

    Raises:
        CloudError: If a project has no cloud, or more than can be looked at.
    """
    clouds: list[Path] = []
    notes: list[str] = []
    for path in paths:
        if path.suffix.lower() != ".toml":
            clouds.append(path)
            continue
        with projects.opened(projects.load_project(path)) as found:
            steps = [one for one in found.states if one.step.kind == "cloud"]
            there = [found.project.output / one.step.outputs[0] for one in steps if one.state in ("done", "stale")]
        there = [file for file in there if file.is_file()]
        if not there:
            raise CloudError(f"{path}: has no cloud yet: {shlex.join(['jaxscan', 'batch', str(path)])}")
        if len(there) > MOST_CLOUDS:
            raise CloudError(f"{path}: has {len(there)} clouds, expected at most {MOST_CLOUDS}; name some of them.")
        clouds += there
        left = [one for one in steps if one.state != "done"]
        notes += [": ".join(filter(None, (one.step.key, one.state, one.why))) for one in left]
    return tuple(clouds), notes


def products_of(paths: Sequence[Path]) -> list[tuple[str, str, str]]:
    """The clouds of projects with name, state, and the reason for it or the notes."""
    rows = []
    for path in paths:
        with projects.opened(projects.load_project(path)) as found:
            rows += [(one.step.key, str(one.state), one.why) for one in found.states]
    return rows


def _read_panorama(path: Path) -> "Panorama":
    from jaxscan.viewer import Panorama
    from jaxscan.vision import read_panorama

    return Panorama(*read_panorama(disk.read_bounded(path, LARGEST_PICTURE, error=CaptureError), name=str(path)))


def _has_screen() -> bool:
    """Whether a browser here would be seen; over SSH it would open in the terminal, or far away."""
    if "SSH_CONNECTION" in os.environ:
        return False
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
