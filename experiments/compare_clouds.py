"""Two clouds of one sweep, by two versions of the code, cell by cell.

A cell is a line of a profile. Differences are along the vector between both points, in units of the first cloud's
random sigma. With --truth, the true cloud on the same grid: a false point is one in a cell that the truth leaves empty.
With --against the clouds are made here, of a capture: the first by the code of another tree, the second by this one.

    python experiments/compare_clouds.py FIRST SECOND [--truth CLOUD] [--cells N] [--json FILE]
    python experiments/compare_clouds.py --against TREE CAPTURE CALIBRATION [--words "…"] [--truth CLOUD] …

The exit code is 1 if the median difference is over 0.05 sigma, or the second cloud has fewer of the true points
(without a truth: fewer points), or more false ones.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from report import command_line, write_json

from jaxscan import api
from jaxscan.reconstruction import PointCloud


OWN = Path(__file__).resolve().parents[1]
MEDIAN_SIGMAS = 0.05
"""Largest median difference that is asked."""


class Grid(NamedTuple):
    """A cloud's fields [profiles, lines]."""

    xyz: np.ndarray
    valid: np.ndarray
    sigma: np.ndarray

    @staticmethod
    def of(cloud: PointCloud) -> "Grid":
        return Grid(*(np.asarray(field) for field in (cloud.xyz, cloud.valid, cloud.sigma_random)))


def compare(first: Grid, second: Grid, truth: Grid | None) -> dict[str, float]:
    """The figures of both clouds, by name."""
    both = first.valid & second.valid
    apart = np.linalg.norm(second.xyz[both].astype(float) - first.xyz[both], axis=1)
    scaled = apart / first.sigma[both]
    out = {
        "points, first": int(first.valid.sum()),
        "points, second": int(second.valid.sum()),
        "in both": int(both.sum()),
        "only in the first": int((first.valid & ~second.valid).sum()),
        "only in the second": int((second.valid & ~first.valid).sum()),
        "difference / sigma, median": float(np.median(scaled)),
        "difference / sigma, 95 %": float(np.quantile(scaled, 0.95)),
        "over 1 sigma apart": int((scaled > 1.0).sum()),
        "over 3 sigma apart": int((scaled > 3.0).sum()),
        "difference, median, mm": 1e3 * float(np.median(apart)),
        "sigma, second / first, median": float(np.median(second.sigma[both] / first.sigma[both])),
    }
    if truth is not None:
        for name, grid in (("first", first), ("second", second)):
            right = grid.valid & truth.valid
            error = np.linalg.norm(grid.xyz[right].astype(float) - truth.xyz[right], axis=1)
            out |= {
                f"true points found, {name}, %": 100.0 * float(right.sum() / truth.valid.sum()),
                f"false points, {name}": int((grid.valid & ~truth.valid).sum()),
                f"error, {name}, median, mm": 1e3 * float(np.median(error)),
                f"over 5 sigma and 1 cm from the truth, {name}": int(
                    ((error > 5.0 * grid.sigma[right]) & (error > 0.01)).sum()
                ),
            }
        false = (second.valid & ~truth.valid) & ~first.valid
        out |= {
            "false points only in the second": int(false.sum()),
            "false points only in the first": int((first.valid & ~truth.valid & ~second.valid).sum()),
        }
    return out


def missed(found: dict[str, float]) -> list[str]:
    """The figures that are not as asked."""
    of = "true points found, {}, %" if "false points, first" in found else "points, {}"
    out = ["difference / sigma, median"] if found["difference / sigma, median"] > MEDIAN_SIGMAS else []
    out += [of.format("second")] if found[of.format("second")] < found[of.format("first")] else []
    more = found.get("false points, second", 0) > found.get("false points, first", 0)
    return [*out, "false points, second"] if more else out


def cell_lines(first: Grid, second: Grid, truth: Grid | None, most: int) -> list[str]:
    """Cells that one cloud alone has, or that moved by over 3 sigma: profile, line, and what the truth says."""
    both = first.valid & second.valid
    apart = np.linalg.norm(second.xyz.astype(float) - first.xyz, axis=2)
    moved = both & (apart > 3.0 * first.sigma)
    kinds = {
        "only in the first": first.valid & ~second.valid,
        "only in the second": second.valid & ~first.valid,
        "moved": moved,
    }
    lines = []
    for kind, cells in kinds.items():
        for k, line in np.argwhere(cells)[:most]:
            grid = first if kind == "only in the first" else second
            said = "" if truth is None else "no true point"
            if truth is not None and truth.valid[k, line]:
                off = np.linalg.norm(grid.xyz[k, line].astype(float) - truth.xyz[k, line])
                said = f"{1e3 * off:.2f} mm from the truth"
            far = f"{apart[k, line] / first.sigma[k, line]:.1f} sigma apart, " if kind == "moved" else ""
            sigma = 1e3 * grid.sigma[k, line]
            lines.append(f"{kind}: profile {k}, line {line}, {far}sigma {sigma:.2f} mm, {said}")
    return lines


def reconstructed(tree: Path, capture: Path, calibration: Path, words: list[str], output: Path) -> PointCloud:
    """The cloud of a capture by one tree's code."""
    places = os.pathsep.join([str(tree), str(tree / "hardware")])
    command = [sys.executable, "-m", "jaxscan", "reconstruct", str(capture), "-c", str(calibration), "--no-cache"]
    command += ["--colour", "stripe", "-o", str(output), *words]
    # The folder of the process comes before all other places of modules.
    subprocess.run(command, cwd=tree, env=os.environ | {"PYTHONPATH": places}, stdout=subprocess.DEVNULL, check=True)
    return api.load_cloud(output)


def main() -> int:
    parser = command_line(__doc__, json=True)
    parser.add_argument("first", type=Path, help="a cloud; with --against a capture")
    parser.add_argument("second", type=Path, help="a cloud; with --against a calibration")
    parser.add_argument("--against", type=Path, metavar="TREE", help="the version that makes the first cloud")
    parser.add_argument("--words", default="", help="more options of `jaxscan reconstruct`, in one word")
    parser.add_argument("--truth", type=Path, help="true cloud on the same grid")
    parser.add_argument("--cells", type=int, default=0, metavar="N", help="list N cells of each kind of difference")
    options = parser.parse_args()
    if options.against is None:
        clouds = [api.load_cloud(path) for path in (options.first, options.second)]
    else:
        with tempfile.TemporaryDirectory() as folder:
            given = options.first.resolve(), options.second.resolve(), options.words.split()
            trees = options.against.resolve(), OWN
            clouds = [reconstructed(tree, *given, Path(folder) / f"{k}.npz") for k, tree in enumerate(trees)]
    first, second = map(Grid.of, clouds)
    truth = None if options.truth is None else Grid.of(api.load_cloud(options.truth))
    shapes = {grid.valid.shape for grid in (first, second, truth) if grid is not None}
    if len(shapes) > 1:
        parser.error(f"found clouds on the grids {sorted(shapes)}, expected one grid: take clouds of the same sweep")
    found = compare(first, second, truth)
    print("| figure | value |", "|---|---:|", *(f"| {key} | {value:.6g} |" for key, value in found.items()), sep="\n")
    print(*cell_lines(first, second, truth, options.cells), sep="\n")
    wrong = missed(found)
    print(*(f"MISSED: {key}" for key in wrong), sep="\n")
    write_json(options.json, {"figures": found, "missed": wrong})
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
