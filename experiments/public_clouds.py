"""Clouds that other programs wrote, converted as a user would, beside another reader of the same format.

    python -m experiments.public_clouds FOLDER [--json FILE]

FOLDER holds clouds of any origin; the page `results/strangers_files.md` names public repositories whose test data were
read so. A cloud agrees if it has as many finite points as the other reader finds, within bounds that are the same but
for the unit that was said. Whatever does not agree is printed, and so is the reason of each refusal.
"""

import contextlib
import io
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.report import command_line
from jaxscan.cli.main import main as jaxscan
from jaxscan.surface import load_open3d


READERS = {".las": "laspy", ".laz": "laspy", ".ply": "Open3D", ".pcd": "Open3D", ".pts": "Open3D", ".xyz": "Open3D"}
READERS |= {".e57": "pye57", ".ptx": "", ".asc": ""}
RELATIVE = 2e-6
"""Of the largest coordinate: singles of both readers [1]."""


class Read(NamedTuple):
    """What a reader found."""

    points: int
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, xyz: np.ndarray) -> "Read":
        """The finite ones of points [N, 3]."""
        xyz = xyz[np.isfinite(xyz).all(-1)]
        return cls(len(xyz), *(xyz.min(0), xyz.max(0)) if len(xyz) else (np.zeros(3), np.zeros(3)))


def by_another(path: Path) -> Read | str:
    """What another reader finds, or why it finds nothing."""
    reader = READERS[path.suffix.lower()]
    try:
        if reader == "laspy":
            import laspy

            return Read.of(np.asarray(laspy.read(path).xyz))
        if reader == "Open3D":
            return Read.of(np.asarray(load_open3d().io.read_point_cloud(str(path)).points))
        if reader == "pye57":
            import pye57

            file = pye57.E57(str(path))
            names = ("cartesianX", "cartesianY", "cartesianZ")
            scans = [file.read_scan(k, ignore_missing_fields=True) for k in range(file.scan_count)]
            found = [np.stack([scan[name] for name in names], -1) for scan in scans]
            return Read.of(np.concatenate(found) if found else np.zeros((0, 3)))
    except BaseException as problem:  # Rust's panics are no exceptions.
        if isinstance(problem, KeyboardInterrupt):
            raise
        return f"{type(problem).__name__}: {problem}".splitlines()[0]
    return "no other reader"


def by_us(path: Path, folder: Path) -> tuple[int, str, Read | None]:
    """Exit code and words of `jaxscan convert`, and what it wrote."""
    out, words = folder / "cloud.ply", io.StringIO()
    out.unlink(missing_ok=True)
    with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
        code = jaxscan(["convert", str(path), str(out)])
    found = Read.of(np.asarray(load_open3d().io.read_point_cloud(str(out)).points)) if out.exists() else None
    return code, " ".join(words.getvalue().split()).replace(str(path), path.name), found


def same(ours: Read, other: Read) -> bool:
    """Whether they agree, but for one factor of all axes or one of heights: a unit that the words name."""
    if ours.points != other.points:
        return False
    extent = [each.high - each.low for each in (ours, other)]
    flat = extent[1] <= RELATIVE * max(np.abs(other.high).max(), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(flat, 1.0, extent[0] / extent[1])
    across = factor[:2][~flat[:2]]
    return bool(across.size < 2 or np.allclose(across, across[0], rtol=1e-3))


def main() -> int:
    """Exit code 1 if a cloud disagrees with the other reader, or an error is none of jaxscan's own."""
    parser = command_line(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path, help="write what came of each file")
    options = parser.parse_args()
    files = sorted(path for path in options.folder.rglob("*") if path.suffix.lower() in READERS and path.is_file())
    counts: Counter[str] = Counter()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for path in files:
            start = time.perf_counter()
            code, words, ours = by_us(path, Path(scratch))
            seconds, other = time.perf_counter() - start, by_another(path)
            if code > 2:
                kind = "DEFECT"
            elif ours is None:
                kind = "refused"
            elif isinstance(other, str) or not other.points:
                kind = "read, where the other reader finds none"
            else:
                kind = "the same" if same(ours, other) else "DIFFERS"
            counts[kind] += 1
            about = other if isinstance(other, str) else f"{other.points} points"
            rows.append({"file": str(path.relative_to(options.folder)), "kind": kind, "seconds": seconds})
            rows[-1] |= {"words": words, "other": about, "points": ours.points if ours else 0}
            if kind != "the same":
                print(f"{kind}: {rows[-1]['file']} ({rows[-1]['points']} points; other: {about})\n    {words[:300]}")
    print(f"{len(files)} files: {dict(counts)}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    return int(counts["DIFFERS"] > 0 or counts["DEFECT"] > 0)


if __name__ == "__main__":
    sys.exit(main())
