"""jaxscan and a plain method on strangers' captures: `experiments/results/real_sets.md`.

    python -m experiments.real_sets.compare CAPTURES [--only NAME …] [--measure after|before|plain …] [--work FOLDER]

CAPTURES holds the captures that `convert` makes, by their names; sets that are not there are skipped. Earlier figures
are kept in `real_sets.json` beside the table. Every run measures the code as it is now ("after"), and the rest if it is
asked for. With --work, a run that was broken off goes on with the set at which it ended.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from experiments.real_sets.figures import Solved
from experiments.real_sets.ours import Version, calibrate, read_solved
from experiments.real_sets.pictures import Pictures
from experiments.real_sets.plain.boards import Lens
from experiments.real_sets.plain.method import PlainBoards, boards, sweep
from experiments.real_sets.sets import SETS, RealSet
from experiments.real_sets.sweeps import reconstruct, table_from, write_rig
from experiments.real_sets.table import markdown


ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "experiments" / "results"
BOARDS_OF_SWEEPS = "srv_laser_1707"
"""The capture that gives camera and sheet of the sweeps."""
MARKED = "srv_table"
"""The sweep whose markers give the axis."""


def kind_of(one: RealSet) -> str:
    """The lens of the plain method."""
    return "fisheye" if "fisheye" in one.lens else "flat"


def measure_boards(one: RealSet, capture: Path, version: Version, work: Path) -> dict[str, Any]:
    """`jaxscan calibrate` as a user types it first, and with fewer wishes where that gives nothing."""
    output = work / f"{one.name}.json"
    runs = [calibrate(version, capture, output, one.lens)]
    if "views" not in runs[-1] and one.camera and version.folder == ROOT:
        # The version before takes no known camera.
        runs.append(calibrate(version, capture, output, ("--camera", str(write_camera(one, capture, work)))))
    elif "views" not in runs[-1]:
        runs.append(calibrate(version, capture, output, ("--only", "camera", *one.lens)))
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


def measure_sweep(one: RealSet, captures: Path, version: Version, work: Path) -> dict[str, Any]:
    """`jaxscan reconstruct` with the plain method's rig, and with the calibration's own camera and sheet."""
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
        found[name] = reconstruct(version, captures / one.name, place, table, one.inner_m)
    return found


def measure_plain(one: RealSet, captures: Path) -> dict[str, Any]:
    """The plain method."""
    pictures = Pictures(captures / one.name)
    if one.header["kind"] == "calibration":
        return boards(pictures, kind_of(one), known_lens(one))[0]
    rig = plain_rig(captures)
    return sweep(pictures, rig.lens, rig.sheets[0], table_from(captures / MARKED, rig.lens), one.inner_m)


def measure(one: RealSet, captures: Path, version: Path | None, work: Path) -> dict[str, Any]:
    """One set by one version, or by the plain method where that is None."""
    if version is None:
        return measure_plain(one, captures)
    code = Version(version.resolve())
    if one.header["kind"] == "calibration":
        return measure_boards(one, captures / one.name, code, work)
    return measure_sweep(one, captures, code, work)


def main() -> int:
    """Measure the sets that are not done, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path)
    parser.add_argument("--only", nargs="*", default=[one.name for one in SETS], metavar="NAME")
    parser.add_argument("--measure", nargs="*", default=["after"], choices=["before", "after", "plain"])
    parser.add_argument("--before", type=Path, help="sources of the version before, for `--measure before`")
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
                print(f"{one.name}: skipped, {capture} is missing; make it with experiments.real_sets.convert")
                continue
            for which in options.measure:
                version = {"plain": None, "before": options.before, "after": ROOT}[which]
                folder = work / which
                folder.mkdir(parents=True, exist_ok=True)
                done = folder / f"{one.name}.done"
                if done.exists():
                    continue
                start = time.perf_counter()
                results.setdefault(one.name, {})[which] = measure(one, captures, version, folder)
                kept.write_text(json.dumps(results, indent=1) + "\n")
                done.touch()
                print(f"{one.name}, {which}: {time.perf_counter() - start:.0f} s", flush=True)
        (options.results / "real_sets.md").write_text(markdown(results))
        print(f"written: {options.results / 'real_sets.md'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
