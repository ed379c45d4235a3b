"""jaxscan and a plain method on captures of other makers: `experiments/results/real_sets.md`.

    python -m experiments.real_sets.compare CAPTURES [--only NAME …] [--measure ours|plain …] [--work FOLDER]

CAPTURES holds the captures that `experiments.real_sets.sets` makes, by their names; sets that are not there are
skipped. Earlier figures are kept in `real_sets.json` beside the page. With --work, a run that was interrupted goes on
with the set at which it ended.
"""

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from experiments.plain import Lens, angle_deg
from experiments.real_sets.measure import (
    Pictures,
    PlainBoards,
    Solved,
    boards,
    calibrate_by_verb,
    read_solved,
    reconstruct,
    reconstruct_stage,
    stage_sweep,
    sweep,
    table_from,
    write_rig,
)
from experiments.real_sets.sets import SETS, RealSet
from experiments.report import RESULTS, command_line, number, table, write_json


HEAD = """# Captures of other makers

`python -m experiments.real_sets.compare CAPTURES` writes this page; `python -m experiments.real_sets.sets` makes the
captures from copies of the public repositories, whose pictures are not part of this project. The plain method
(`experiments/plain.py`) is OpenCV's `findChessboardCorners`, `cornerSubPix` and `calibrateCamera`, a centroid on
every line, and RANSAC for lines and planes; "free" is `calibrateCameraRO`, in which every corner of the board is
free. Nothing here has a known truth: held-out figures are of views that had no part in the solve but for their own
pose. Distances of corners are lengths of vectors, √2 of the deviation of one coordinate. The plain method finds its
own corners, so its figures are of other corners than jaxscan's.
"""


def markdown(results: dict[str, Any]) -> str:
    """The page."""
    known = [one for one in SETS if one.name in results]
    boards = [one for one in known if one.header["kind"] == "calibration"]
    parts = [HEAD, "## The sets", _sets(known, results)]
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
Camera and sheet come from `srv_laser_1707`, the axis from the ArUco markers on the table. "Plain rig" is the plain
method's camera and sheet, given to jaxscan as a file written by hand; "own rig" is with jaxscan's own. "scene" counts
the points less than 125 mm from the axis, up to 200 mm above the table; "on table" those within 6 mm of the plane of
its surface, of whose distances the spread is 1.48 of the median and the RMS is given; "tilt" is the angle of that
plane against the plane of the markers. That plane itself moves by 0.03° when other steps of the table are taken, so
smaller differences say nothing.

Sweeps of a printer's head come with no calibration of use. Their rig is made up, so that their millimetres are near the
true ones and no more: "on table" counts the points within 1 mm of the cubic surface that most points share, the bed.
"""


LAST_UNDATED = "2026-11-28"
"""After it results hold the day on which they were measured."""


def _sets(known: list[RealSet], results: dict[str, Any]) -> str:
    rows = []
    for one in known:
        place = one.repository if one.repository == "opencv/opencv" else f"{one.repository} {one.commit[:7]}"
        when = results[one.name].get("ours", {}).get("measured", f"{LAST_UNDATED} or before")
        rows.append([one.name, place, one.licence, one.about, one.reference or "none", when])
    return table(["set", "repository", "licence", "capture", "published", "jaxscan of"], rows)


def _sentences(boards: list[RealSet], results: dict[str, Any]) -> str:
    rows = []
    for one in boards:
        found = results[one.name].get("ours")
        if found is None:
            continue
        text = f"({found['plan']}) {found['first']}" if found.get("plan") else found["first"]
        if found["runs"] > 1:
            how = "With the known camera" if found["options"].startswith("--camera") else "With `--only camera`"
            text += f" **{how}:** {found['sentence']}"
        rows.append([one.name, str(found["exit_code"]), text.replace("|", "/")])
    return table(["set", "exit code", "first sentence"], rows)


def _corners(boards: list[RealSet], results: dict[str, Any]) -> str:
    head = ["set", "views", "plain", "ratio", "RMS [px]", "plain", "held out [px]", "plain", "free"]
    rows = []
    for one in boards:
        ours, plain = (results[one.name].get(which, {}) for which in ("ours", "plain"))
        held_out = number(ours.get("held_out_px"))
        if ours.get("held_out_px") is None and ours.get("held_out_own_px") is not None:
            held_out = f"({number(ours['held_out_own_px'])})"
        rows.append(
            [
                one.name,
                number(ours.get("views"), "{:.0f}"),
                "OpenCV fails" if "error" in plain else f"{plain.get('views', 0)} of {plain.get('records', 0)}",
                number(ours.get("corner_noise_over_sigma"), "{:.2f}"),
                number(ours.get("corner_rms_px")),
                number(plain.get("corner_rms_px")),
                held_out,
                number(plain.get("held_out_px")),
                number(plain.get("held_out_free_px")),
                number(ours.get("shape_mm")),
                number(plain.get("free_shape_mm")),
            ]
        )
    return table([*head, "shape [mm]", "free"], rows)


PUBLISHED = {"zhaocongyang": (np.array([-0.13051671, -6.3959525, 1.0]), 304.91858)}
"""Sheets by their makers: the plane n · p = -d [mm]."""


def _lines(boards: list[RealSet], results: dict[str, Any]) -> str:
    head = ["set", "method", "lines", "points", "spread [mm]", "held out [mm]", "halves [°]", "angle to plain [°]"]
    rows = []
    for one in boards:
        if not one.header.get("laser"):
            continue
        plain = (results[one.name].get("plain", {}).get("sheets") or [None])[0]
        for which, name in (("ours", "jaxscan"), ("plain", "plain")):
            sheet = (results[one.name].get(which, {}).get("sheets") or [None])[0]
            cells = [one.name if which == "ours" else "", name]
            rows.append(cells + (["no sheet"] + ["–"] * 5 if sheet is None else _sheet(one, sheet, plain)))
    return table(head, rows)


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
        ("spread_mm", number),
        ("held_out_mm", number),
        ("halves_deg", lambda value: number(value, "{:.2f}")),
    ]
    return [write(sheet.get(key)) for key, write in keys] + [angle]


def _sweeps(sweeps: list[RealSet], results: dict[str, Any]) -> str:
    head = ["set", "method", "points", "scene", "on table", "spread [mm]", "RMS [mm]", "tilt [°]", "notes"]
    rows = []
    for one in sweeps:
        found = results[one.name]
        runs = [
            ("jaxscan, plain rig", found.get("ours", {}).get("with_plain_rig")),
            ("jaxscan, own rig", found.get("ours", {}).get("with_own_rig")),
            ("jaxscan, made-up rig", found.get("ours", {}).get("with_made_up_rig")),
            ("plain", found.get("plain")),
        ]
        for k, (name, run) in enumerate([(name, run) for name, run in runs if run is not None]):
            notes = run.get("notes", [])
            notes = notes or [run["error"]] if run.get("error") else notes
            cells = [str(run.get(key, "–")) for key in ("points", "scene", "on_table")]
            cells += [number(run.get(key)) for key in ("spread_mm", "rms_mm")] + [number(run.get("tilt_deg"), "{:.2f}")]
            text = " ".join(notes).replace("|", "/") or "nothing"
            rows.append([one.name if k == 0 else "", name, *cells, text if name != "plain" else ""])
    return table(head, rows)


SAME = 1.02
"""Figures that differ by less are the same."""
MORE, LESS = +1, -1
BOARD_FIGURES = (("views", MORE), ("held_out_px", LESS), ("corner_rms_px", LESS))
LINE_FIGURES = (("lines", MORE), ("points", MORE), ("spread_mm", LESS), ("held_out_mm", LESS), ("halves_deg", LESS))
SWEEP_FIGURES = (("scene", MORE), ("on_table", MORE), ("spread_mm", LESS), ("rms_mm", LESS), ("tilt_deg", LESS))


def worse(results: dict[str, Any]) -> str:
    """A list of all figures in which jaxscan is worse."""
    found: list[str] = []
    compared = 0
    for one in SETS:
        own, plain = results.get(one.name, {}).get("ours"), results.get(one.name, {}).get("plain")
        if own is None or plain is None:
            continue
        pairs = [(f"{one.name}, boards", BOARD_FIGURES, own, plain)]
        if one.header["kind"] == "sweep":
            names = ("plain rig", "own rig", "made-up rig")
            rigs = [(name, f"with_{name.replace('-', '_').replace(' ', '_')}") for name in names]
            pairs = [(f"{one.name}, {name}", SWEEP_FIGURES, own[key], plain) for name, key in rigs if key in own]
        elif plain.get("sheets"):
            sheet = (own.get("sheets") or [{}])[0]
            pairs.append((f"{one.name}, lines on boards", LINE_FIGURES, sheet, plain["sheets"][0]))
        for name, wanted, ours, theirs in pairs:
            known = [(key, sense) for key, sense in wanted if theirs.get(key) is not None]
            compared += len(known)
            found += [
                f"- {name}: {key} {_text(ours.get(key))}, plain {_text(theirs[key])}"
                for key, sense in known
                if _is_worse(ours.get(key), theirs[key], sense)
            ]
    return "\n".join([f"{len(found)} of {compared} figures are worse, by more than 2 %:", "", *found])


def _is_worse(ours: float | None, theirs: float, sense: int) -> bool:
    if ours is None:
        return True
    return ours * SAME < theirs if sense == MORE else ours > theirs * SAME


def _text(value: float | None) -> str:
    return "missing" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


BOARDS_OF_SWEEPS = "srv_laser_1707"
"""The capture that gives camera and sheet of the sweeps."""
MARKED = "srv_table"
"""The sweep whose markers give the axis."""


def kind_of(one: RealSet) -> str:
    """The lens of the plain method."""
    return "fisheye" if "fisheye" in one.lens else "flat"


def measure_boards(one: RealSet, capture: Path, work: Path) -> dict[str, Any]:
    """`jaxscan calibrate` as a user types it; if that gives nothing, with the known camera or for the camera alone."""
    output = work / f"{one.name}.json"
    runs = [calibrate_by_verb(capture, output, one.lens)]
    if "views" not in runs[-1]:
        fewer = ("--camera", str(write_camera(one, capture, work))) if one.camera else ("--only", "camera", *one.lens)
        runs.append(calibrate_by_verb(capture, output, fewer))
    return runs[-1] | {"first": runs[0]["sentence"], "first_exit_code": runs[0]["exit_code"], "runs": len(runs)}


def known_lens(one: RealSet) -> Lens | None:
    """The camera that the authors calibrated elsewhere."""
    if not one.camera:
        return None
    fx, fy, cx, cy, *distortion = one.camera
    return Lens(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(distortion))


def write_camera(one: RealSet, capture: Path, work: Path) -> Path:
    """That camera as OpenCV writes it."""
    path, lens, size = work / f"{one.name}_camera.yaml", known_lens(one), Pictures(capture).size
    assert lens is not None
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", size[0])
    file.write("image_height", size[1])
    file.write("camera_matrix", lens.matrix)
    file.write("distortion_coefficients", lens.distortion[None])
    file.release()
    return path


def plain_rig(captures: Path) -> Solved:
    """Camera and sheet of the plain method for the sweeps."""
    return PlainBoards(Pictures(captures / BOARDS_OF_SWEEPS), "flat").solve()


def measure_sweep(one: RealSet, captures: Path, work: Path) -> dict[str, Any]:
    """`jaxscan reconstruct` with the plain method's rig, and with the calibration's own camera and sheet."""
    if one.rig is not None:
        made_up = work / f"{one.name}_rig.json"
        write_json(made_up, one.rig)
        return {"with_made_up_rig": reconstruct_stage(captures / one.name, made_up)}
    found: dict[str, Any] = {}
    own = work / f"{BOARDS_OF_SWEEPS}.json"
    rigs = {"with_plain_rig": plain_rig(captures)}
    solved = read_solved(own, Pictures(captures / BOARDS_OF_SWEEPS)) if own.exists() else None
    if solved is not None and solved.sheets:
        rigs["with_own_rig"] = solved
    for name, rig in rigs.items():
        table = table_from(captures / MARKED, rig.lens)
        place = work / f"{name}.json"
        write_rig(place, Pictures(captures / one.name).size, rig.lens, rig.sheets[0], table)
        found[name] = reconstruct(captures / one.name, place, table, one.inner_m)
    return found


def measure_plain(one: RealSet, captures: Path) -> dict[str, Any]:
    """The plain method."""
    pictures = Pictures(captures / one.name)
    if one.header["kind"] == "calibration":
        try:
            return boards(pictures, kind_of(one), known_lens(one))[0]
        except cv2.error as problem:
            # OpenCV's solve for a fisheye gives up on some sets.
            return {"error": str(problem), "records": len(pictures.records)}
    if one.rig is not None:
        return stage_sweep(pictures, one.rig)
    rig = plain_rig(captures)
    return sweep(pictures, rig.lens, rig.sheets[0], table_from(captures / MARKED, rig.lens), one.inner_m)


def measure(one: RealSet, captures: Path, which: str, work: Path) -> dict[str, Any]:
    """One set by jaxscan, or by the plain method."""
    if which == "plain":
        return measure_plain(one, captures)
    if one.header["kind"] == "calibration":
        return measure_boards(one, captures / one.name, work)
    return measure_sweep(one, captures, work)


def main() -> int:
    """Measure the sets that are not done, and write the table."""
    parser = command_line(__doc__)
    parser.add_argument("captures", type=Path)
    parser.add_argument("--only", nargs="*", default=[one.name for one in SETS], metavar="NAME")
    parser.add_argument("--measure", nargs="*", default=["ours"], choices=["ours", "plain"])
    parser.add_argument("--work", type=Path, help="folder for calibrations and clouds; a finished set is not run again")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    captures = options.captures.resolve()
    with tempfile.TemporaryDirectory() as scratch:
        work = (options.work or Path(scratch)).resolve()
        kept = options.results / "real_sets.json"
        results: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
        for one in SETS:
            if one.name not in options.only:
                continue
            capture = captures / one.name
            if not (capture / "capture.toml").exists():
                print(f"{one.name}: skipped, {capture} is missing; make it with experiments.real_sets.sets")
                continue
            for which in options.measure:
                folder = work / which
                folder.mkdir(parents=True, exist_ok=True)
                done = folder / f"{one.name}.done"
                if done.exists():
                    continue
                start = time.perf_counter()
                found = measure(one, captures, which, folder) | {"measured": time.strftime("%Y-%m-%d")}
                results.setdefault(one.name, {})[which] = found
                write_json(kept, results)
                done.touch()
                print(f"{one.name}, {which}: {time.perf_counter() - start:.0f} s", flush=True)
        (options.results / "real_sets.md").write_text(markdown(results))
        print(f"written: {options.results / 'real_sets.md'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
