"""The verbs: one file each, imported when the verb is called."""

import importlib
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

import jaxscan
from jaxscan.cli.help import (
    SHELLS,
    Mistake,
    Verb,
    completion,
    entries_of,
    overview,
    read_words,
    short,
    unknown_verb,
    verb_page,
)
from jaxscan.cli.terminal import Terminal, json_to


DESCRIPTION = "A camera, a line laser and a turntable as a precise 3D scanner for rooms."
VERBS = {
    "demo": "Calibrate, scan, reconstruct and measure a simulated room: `jaxscan demo`.",
    "init": "Write a configuration to start from: `jaxscan init scan.toml`. All there are: `jaxscan init --list`.",
    "design": "Choose camera, lens, baseline and laser for an accuracy: `jaxscan design --range 4 --sigma 1mm`.",
    "board": "Print a calibration board: `jaxscan board board.toml -o board.pdf --paper A3`.",
    "simulate": "Render a simulated rig: `jaxscan simulate paper.toml -o captures/paper --every 10`.",
    "calibrate": "Calibrate the rig: `jaxscan calibrate captures/boards -o calibration.json`.",
    "recalibrate": "Recalibrate from sweeps of a room: `jaxscan recalibrate captures/room -c old.json -o new.json`.",
    "reconstruct": "Reconstruct a sweep: `jaxscan reconstruct captures/room -c calibration.json -o room.ply`.",
    "scan": "Scan with a rig: `jaxscan scan scan.toml -o captures/room`.",
    "console": "Scan from a web page: `jaxscan console scan.toml`.",
    "view": "Look around in clouds: `jaxscan view room.ply -c calibration.json`.",
    "panorama": "Draw the room all around: `jaxscan panorama captures/room -c calibration.json -o room.jpg`.",
    "mesh": "Make a mesh of a cloud: `jaxscan mesh room.ply -o room.glb`.",
    "project": "Many captures as one project: `jaxscan project init FOLDER` (`jaxscan project --help`).",
    "batch": "Make what a project lacks: `jaxscan batch project.toml`.",
    "measure": "Measure a cloud: room, distance, plane, sphere and others (`jaxscan measure --help`).",
    "plan": "Draw a room: `jaxscan plan room.ply -c calibration.json -o plan.dxf`.",
    "orthophoto": "Draw the walls of a room straight on: `jaxscan orthophoto room.ply -o walls`.",
    "import": "Make a capture of another program's images: `jaxscan import FOLDER -o captures/room --step-deg 0.9`.",
    "align": "Put a cloud in a frame: `jaxscan align room.ply -o levelled.ply --room`, or `--targets targets.toml`.",
    "clean": "Leave out points of a cloud: `jaxscan clean room.ply -o small.ply --isolated-mm 30 --thin-mm 10`.",
    "register": "Join stations to one cloud: `jaxscan register captures/a captures/b -c calibration.json -o room.e57`.",
    "convert": "Convert a cloud, a calibration or a capture: `jaxscan convert room.ply room.e57`.",
    "report": "Draw the report of a calibration or a cloud: `jaxscan report calibration.json -o report.html`.",
    "info": "Say what a file is: `jaxscan info room.ply`.",
    "doctor": "Check this machine: `jaxscan doctor`. A rig: `jaxscan doctor --config scan.toml`.",
}
"""The first line of each verb's docstring, for the list of verbs: it is shown without loading any verb."""
MEASURES = {
    "room": "Wall to wall: `jaxscan measure room room.ply -c calibration.json`.",
    "distance": "Between two picked points: `jaxscan measure distance room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.",
    "plane": "Flatness around a point: `jaxscan measure plane room.ply --at 1.9 0.2 0.1`.",
    "points": "Between two single points: `jaxscan measure points room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.",
    "sphere": "Centre and radius of a sphere: `jaxscan measure sphere room.ply --near 1 0.2 0.1 --radius-mm 70`.",
    "deviations": "Deviations from a plane: `jaxscan measure deviations room.ply --at 1.9 0.2 0.1 -o map.png`.",
    "compare": "Against a true or better cloud: `jaxscan measure compare room.ply truth.npz`.",
}
"""The same for the verbs below `jaxscan measure`."""
PROJECTS = {
    "init": "Write the project of what lies in a folder: `jaxscan project init FOLDER`.",
    "status": "Say what is done, stale, failed and missing: `jaxscan project status project.toml`.",
    "compare": "Lengths of two epochs or two versions: `jaxscan project compare old/project.toml new/project.toml`.",
}
"""The same for the verbs below `jaxscan project`."""
BELOW = {"measure": MEASURES, "project": PROJECTS}
"""Verbs that are followed by another."""

HELP = ("-h", "--help")
USAGE = 2
"""The exit code of a mistake in the words."""

_FILES = {
    **dict.fromkeys(("init", "board", "simulate"), "prepare"),
    **dict.fromkeys(("plan", "orthophoto", "panorama"), "draw"),
    **dict.fromkeys(("convert", "align", "clean", "register"), "clouds"),
    "import": "import_",
    "batch": "project",
    "console": "console.console",
}
"""Files of the verbs that are not in one of their name."""


def load_verb(*words: str) -> Callable[..., None]:
    """The function of a verb, or of two words such as "measure room"; its file is imported now."""
    first, verb = words[0], words[-1]
    # No function of Python can be called "import".
    name = "import_" if verb == "import" else verb
    function: Callable[..., None] = getattr(importlib.import_module(f"jaxscan.cli.{_FILES.get(first, first)}"), name)
    return function


def parse(words: Sequence[str]) -> Callable[[], None]:
    """The work that a command line asks for, to be called.

    Raises:
        SystemExit: After a request for help, or a mistake, was answered.
    """
    words = list(words)
    if words == ["--version"]:
        return lambda: Terminal().print(f"jaxscan {jaxscan.__version__}")
    if words[:1] == ["--completion"]:
        return _completion(words[1:])
    prog, says, verbs = "jaxscan", DESCRIPTION, VERBS
    above = words[:1] if words and words[0] in BELOW else []
    if above:
        (first,) = above
        prog, says, verbs, words = f"jaxscan {first}", short(VERBS[first]), BELOW[first], words[1:]
    if not words or words[0] in HELP:
        print(overview(prog, says, verbs), end="", file=sys.stdout if words else sys.stderr)
        raise SystemExit(0 if words else USAGE)
    verb, *rest = words
    if verb not in verbs:
        _leave(unknown_verb(verb, prog, list(verbs)))
    function = load_verb(*above, verb)
    if set(HELP) & set(rest):
        print(verb_page(f"{prog} {verb}", function), end="")
        raise SystemExit(0)
    entries = entries_of(function)
    try:
        values = read_words(rest, f"{prog} {verb}", entries)
    except Mistake as mistake:
        _leave(str(mistake))
    target = values.pop("json", None)
    arguments = [values.pop(entry.key) for entry in entries if not entry.names and entry.key in values]

    def work() -> None:
        with json_to(target, "-".join([*above, verb])):
            function(*arguments, **values)

    return work


def _completion(words: Sequence[str]) -> Callable[[], None]:
    if len(words) != 1 or words[0] not in SHELLS:
        _leave(f"--completion needs the name of a shell: {', '.join(SHELLS)}.")
    names = [(name,) for name in VERBS] + [(first, name) for first, verbs in BELOW.items() for name in verbs]
    known = [Verb(name, entries_of(load_verb(*name))) for name in names]
    return lambda: print(completion(words[0], known), end="")


def _leave(line: str) -> NoReturn:
    """Answer a mistake with one line, and end."""
    Terminal(stderr=True).print(f"jaxscan: {line}")
    raise SystemExit(USAGE)
