"""Memory and processor time of the verbs that read and write clouds, each in a process of its own.

Two clouds of a room are made: one of points alone, as other programs write it (15 bytes a point), and one on the
grid of a scanner, with all that this library says of a point. Each is converted to every format, each of these is
converted back to PLY, and a few verbs measure it. A line of the table says the peak of resident memory of the whole
process, how much that is for each point beyond the same command with a cloud of few points, and the time of the
processor.

    python experiments/cloud_memory.py [--points 10000000] [--only WORD] [--json FILE]
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from report import command_line, write_json

from jaxscan.files.clouds import save_cloud
from jaxscan.reconstruction import PointCloud


FEW = 20_000
"""Points of the small cloud, whose command shows what the program itself takes."""
LINES = 2000
FORMATS = ("npz", "ply", "pcd", "xyz", "ptx", "las", "laz", "e57")
HALF_M = np.array([2.1, 1.6, 1.25], np.float32)
"""Half the length, width and height of the room."""
AT = ["2.1", "0.2", "0.1"]
"""A place on a wall."""
MEASURES = {
    "measure room": [],
    "measure plane": ["--at", *AT],
    "measure distance": ["--a", *AT, "--b", "-2.1", "0.2", "0.1"],
    "measure points": ["--a", *AT, "--b", "-2.1", "0.2", "0.1"],
    "measure sphere": ["--near", "0.5", "0.5", "0.1", "--radius", "0.07"],
    "measure deviations": ["--at", *AT, "-o", "OUT/map.png"],
    "align": ["--room", "-o", "OUT/aligned.ply"],
}
_RUN = "import sys; from jaxscan.cli.main import main; sys.exit(main())"


def make_cloud(points: int) -> PointCloud:
    """A room as a scanner in its middle sees it, with a ball in it, on a grid of about so many points."""
    random = np.random.default_rng(0)
    lines = min(LINES, max(20, int(points**0.5)))
    profiles = points // lines
    angle = np.linspace(0, 2 * np.pi, profiles, endpoint=False)
    up = np.linspace(-1.2, 1.2, lines)
    xyz = np.empty((profiles, lines, 3), np.float32)
    normals = np.zeros_like(xyz)
    ball, radius = np.array([0.5, 0.5, 0.1]), 0.07
    for number, turn in enumerate(angle):
        ray = np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)], -1)
        reach = HALF_M / np.maximum(np.abs(ray), 1e-9)
        side = reach.argmin(-1)
        distance = reach.min(-1)
        normals[number, np.arange(lines), side] = -np.sign(ray[np.arange(lines), side])
        near = ray @ ball
        inside = radius**2 - (ball @ ball - near**2)
        distance = np.where(inside > 0, near - np.sqrt(np.maximum(inside, 0)), distance)
        distance += 5e-4 * random.standard_normal(lines)
        xyz[number] = ray * distance[:, None]
    return PointCloud(
        xyz=xyz,
        rgb=random.integers(30, 200, xyz.shape, np.uint8),
        intensity=random.uniform(20, 200, xyz.shape[:2]).astype(np.float32),
        normals=normals,
        sigma_random=np.full(xyz.shape[:2], 5e-4, np.float32),
        sigma_systematic=np.full(xyz.shape[:2], 2e-4, np.float32),
        valid=random.random(xyz.shape[:2]) > 1e-3,
        record=np.arange(profiles, dtype=np.int32),
        laser=np.zeros(profiles, np.int32),
        angle=angle,
    )


def write_points(cloud: PointCloud, path: Path) -> None:
    """The points and colours of a cloud as another program writes them."""
    valid = np.asarray(cloud.valid)
    record = np.dtype([(axis, "<f4") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")])
    vertices = np.empty(np.count_nonzero(valid), record)
    for k, axis in enumerate("xyz"):
        vertices[axis] = cloud.xyz[..., k][valid]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = cloud.rgb[..., k][valid]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    with open(path, "wb") as file:
        file.write("\n".join([*header, "end_header", ""]).encode())
        vertices.tofile(file)


def make_files(folder: Path, points: int) -> None:
    """The two clouds as PLY."""
    folder.mkdir(parents=True)
    cloud = make_cloud(points)
    write_points(cloud, folder / "points.ply")
    save_cloud(cloud, folder / "grid.ply")


def run(words: list[str]) -> tuple[float, float, str]:
    """Peak of resident memory [bytes] and processor time [s] of a verb, and the last line where it failed."""
    with tempfile.TemporaryFile("w+") as said:
        child = subprocess.Popen([sys.executable, "-c", _RUN, *words], stdout=subprocess.DEVNULL, stderr=said)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        last = (said.read().strip().splitlines() or ["failed"])[-1] if child.returncode else ""
    return 1024 * used.ru_maxrss, used.ru_utime + used.ru_stime, last


def commands(folder: Path, kind: str) -> list[tuple[str, list[str]]]:
    """Name and words of every command for a cloud."""
    source = str(folder / f"{kind}.ply")
    found = []
    for suffix in FORMATS:
        there = str(folder / f"{kind}-copy.{suffix}")
        found.append((f"{kind}: ply to {suffix}", ["convert", source, there]))
        found.append((f"{kind}: {suffix} to ply", ["convert", there, str(folder / "back.ply")]))
    for verb, rest in MEASURES.items():
        words = [word.replace("OUT", str(folder)) for word in rest]
        found.append((f"{kind}: {verb}", [*verb.split(), source, *words]))
        if verb == "measure room":
            other = str(folder / f"{kind}-copy.e57")
            found.append((f"{kind}: {verb}, e57", [*verb.split(), other, *words]))
    return found


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--only", default="", help="only commands whose names hold this")
    parser.add_argument("--folder", type=Path, help="where the clouds are kept")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.make:
        make_files(asked.make, asked.points)
        return
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        root = asked.folder or Path(temporary)
        small, large = root / "few", root / "many"
        for folder, points in ((small, FEW), (large, asked.points)):
            if not folder.exists():
                # In a process of its own: what the files are made with is no part of what is measured.
                subprocess.run([sys.executable, __file__, "--make", str(folder), "--points", str(points)], check=True)
        print(f"{'command':34} {'peak MB':>8} {'bytes a point':>14} {'CPU s':>7}")
        for kind in ("points", "grid"):
            for (name, few), (_, many) in zip(commands(small, kind), commands(large, kind), strict=True):
                if asked.only not in name:
                    continue
                base = run(few)[0]
                peak, seconds, said = run(many)
                each = (peak - base) / asked.points
                print(f"{name:34} {peak / 1e6:8.0f} {each:14.0f} {seconds:7.1f} {said}", flush=True)
                rows.append({"command": name, "peak_bytes": peak, "bytes_a_point": each, "cpu_s": seconds})
    write_json(asked.json, rows)


if __name__ == "__main__":
    main()
