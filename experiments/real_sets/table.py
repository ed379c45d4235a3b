"""The table of results, from what `compare` has measured."""

from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.real_sets.plain.stripes import angle_deg
from experiments.real_sets.sets import SETS, RealSet
from experiments.real_sets.worse import worse


HEAD = """# Strangers' captures

`python -m experiments.real_sets.compare CAPTURES` writes this page; `experiments.real_sets.convert` makes the
captures from copies of the public repositories, whose pictures are not part of this project. "before" is commit
41c6dff, "now" the code beside this page. The plain method (`experiments/real_sets/plain`) is OpenCV's
`findChessboardCorners`, `cornerSubPix` and `calibrateCamera`, a centroid on every line, and RANSAC for lines and
planes; "free" is `calibrateCameraRO`, in which every corner of the board is free. Nothing here has a known truth:
held-out figures are of views that had no part in the solve but for their own pose. Distances of corners are lengths
of vectors, √2 of the deviation of one coordinate. The plain method finds its own corners, so its figures are of other
corners than jaxscan's.
"""


def markdown(results: dict[str, Any]) -> str:
    """The page."""
    known = [one for one in SETS if one.name in results]
    boards = [one for one in known if one.header["kind"] == "calibration"]
    parts = [HEAD, "## The sets", _sets(known)]
    parts += ["## The first sentence", _sentences(boards, results)]
    parts += ["## Corners", CORNERS, _corners(boards, results)]
    parts += ["## Lines on boards", LINES, _lines(boards, results)]
    sweeps = [one for one in known if one.header["kind"] == "sweep"]
    parts += ["## Sweeps", SWEEPS, _sweeps(sweeps, results)]
    parts += ["## Worse than the plain method", worse(results)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


CORNERS = """
"ratio" is the noise of the corners over that which the corner detector promised. "held out" is the RMS of corners in
the half of the views that was not solved from; in brackets, jaxscan's own prediction of views that it left out. "shape"
is the RMS by which the board is off flat, as calibrated.
"""
LINES = """
The spread is 1.48 times the median distance of the line's points on the boards from the sheet, "held out" the same for
the sheet of the other half of the views, "halves" the angle between the sheets of both halves.
"""
SWEEPS = """
Camera and sheet come from `srv_laser_1707`, the axis from the ArUco markers on the table. Before, no sheet was found,
so that the plain method's camera, sheet and axis are given to jaxscan as a file written by hand; "own rig" is with
jaxscan's own camera and sheet. "scene" counts the points less than 125 mm from the axis, up to 200 mm above the
table; "on table" those within 6 mm of the plane of its surface, of whose distances the spread is 1.48 of the median
and the RMS is given; "tilt" is the angle of that plane against the plane of the markers. That plane itself moves by
0.03° when other steps of the table are taken, so smaller differences say nothing.
"""


def _rows(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines)


def _number(value: Any, form: str = "{:.3f}") -> str:
    return "–" if value is None or not np.isfinite(value) else form.format(value)


def _change(found: dict[str, Any], key: str, form: str = "{:.3f}") -> str:
    return " → ".join(_number(found.get(which, {}).get(key), form) for which in ("before", "after"))


def _sets(known: list[RealSet]) -> str:
    rows = []
    for one in known:
        place = one.repository if one.repository == "opencv/opencv" else f"{one.repository} {one.commit[:7]}"
        rows.append([one.name, place, one.licence, one.about, one.reference or "none"])
    return _rows(["set", "repository", "licence", "capture", "published"], rows)


def _sentences(boards: list[RealSet], results: dict[str, Any]) -> str:
    rows = []
    for one in boards:
        for which in ("before", "after"):
            found = results[one.name].get(which)
            if found is None:
                continue
            plan = found.get("plan", "")
            text = f"({plan}) {found['first']}" if plan else found["first"]
            text = text.replace("|", "/")
            # The version before knew no board of circles, and was given centres that OpenCV found.
            how = "With centres found by OpenCV"
            if found["options"].startswith("--camera"):
                how = "With the known camera"
            elif "--only" in found["options"]:
                how = "With `--only camera`"
            if found["runs"] > 1:
                text += f" **{how}:** {found['sentence']}".replace("|", "/")
            name = one.name if which == "before" else ""
            when = "before" if which == "before" else "now"
            rows.append([name, when, str(found["exit_code"]), text])
    return _rows(["set", "", "exit code", "first sentence"], rows)


def _corners(boards: list[RealSet], results: dict[str, Any]) -> str:
    head = [
        "set",
        "views",
        "plain",
        "ratio",
        "RMS [px]",
        "plain",
        "held out [px]",
        "plain",
        "free",
        "shape [mm]",
        "free",
    ]
    rows = []
    for one in boards:
        found = results[one.name]
        plain = found.get("plain", {})
        rows.append(
            [
                one.name,
                _change(found, "views", "{:.0f}"),
                f"{plain.get('views', 0)} of {plain.get('records', 0)}",
                _change(found, "corner_noise_over_sigma", "{:.2f}"),
                _change(found, "corner_rms_px"),
                _number(plain.get("corner_rms_px")),
                _held_out(found),
                _number(plain.get("held_out_px")),
                _number(plain.get("held_out_free_px")),
                _change(found, "shape_mm"),
                _number(plain.get("free_shape_mm")),
            ]
        )
    return _rows(head, rows)


def _held_out(found: dict[str, Any]) -> str:
    """The halves' figure, or in brackets that of the solve itself, where the halves could not be solved."""
    now = found.get("after", {})
    if now.get("held_out_px") is None and now.get("held_out_own_px") is not None:
        return f"{_number(found.get('before', {}).get('held_out_px'))} → ({_number(now['held_out_own_px'])})"
    return _change(found, "held_out_px")


PUBLISHED = {"zhaocongyang": (np.array([-0.13051671, -6.3959525, 1.0]), 304.91858)}
"""Sheets by their makers: the plane n · p = -d [mm]."""


def _lines(boards: list[RealSet], results: dict[str, Any]) -> str:
    head = ["set", "method", "lines", "points", "spread [mm]", "held out [mm]", "halves [°]", "angle to plain [°]"]
    rows = []
    for one in boards:
        if not one.header.get("laser"):
            continue
        plain = (results[one.name].get("plain", {}).get("sheets") or [None])[0]
        for which, name in (("before", "before"), ("after", "now"), ("plain", "plain")):
            sheet = (results[one.name].get(which, {}).get("sheets") or [None])[0]
            cells = [one.name if which == "before" else "", name]
            rows.append(cells + (["no sheet"] + ["–"] * 5 if sheet is None else _sheet(one, sheet, plain)))
    return _rows(head, rows)


def _sheet(one: RealSet, sheet: dict[str, Any], plain: dict[str, Any] | None) -> list[str]:
    def against(normal: Any) -> str:
        return f"{angle_deg(np.array(sheet['normal']), np.array(normal)):.2f}"

    angle = "–" if plain is None else against(plain["normal"])
    if one.name in PUBLISHED:
        normal, _ = PUBLISHED[one.name]
        angle += f"; {against(normal / np.linalg.norm(normal))} to the published one"
    keys: list[tuple[str, Callable[[Any], str]]] = [
        ("lines", str),
        ("points", str),
        ("spread_mm", _number),
        ("held_out_mm", _number),
        ("halves_deg", lambda value: _number(value, "{:.2f}")),
    ]
    return [write(sheet.get(key)) for key, write in keys] + [angle]


def _sweeps(sweeps: list[RealSet], results: dict[str, Any]) -> str:
    head = ["set", "method", "points", "scene", "on table", "spread [mm]", "RMS [mm]", "tilt [°]", "said"]
    rows = []
    for one in sweeps:
        found = results[one.name]
        runs = [
            ("before, plain rig", found.get("before", {}).get("with_plain_rig")),
            ("now, plain rig", found.get("after", {}).get("with_plain_rig")),
            ("now, own rig", found.get("after", {}).get("with_own_rig")),
            ("plain", found.get("plain")),
        ]
        for k, (name, run) in enumerate(runs):
            if run is None:
                continue
            said = run.get("said", [])
            said = said or [run["error"]] if run.get("error") else said
            cells = [str(run.get(key, "–")) for key in ("points", "scene", "on_table")]
            cells += [_number(run.get(key)) for key in ("spread_mm", "rms_mm")] + [
                _number(run.get("tilt_deg"), "{:.2f}")
            ]
            text = " ".join(said).replace("|", "/") or "nothing"
            rows.append([one.name if k == 0 else "", name, *cells, text if k < 3 else ""])
    return _rows(head, rows)
