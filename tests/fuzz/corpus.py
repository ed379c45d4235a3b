"""Small valid files of every format, from which cases are made; the outputs that they give unchanged."""

import json
import re
import shutil
from pathlib import Path

import numpy as np

from jaxscan.files.clouds import FORMATS

from ..files.strangers import STRANGERS
from .project_cases import KNOWN, TARGETS


RECORDS = 12
VIEWS = 6
# What makes it small comes first, so that a file cut short is refused, not rendered in full size.
RIG = """
seed = 5
[camera]
width = 64
height = 48
fx = 50.0
fy = 50.0
[plan]
steps = 3
[boards]
type = "charuco"
columns = 5
rows = 4
free_views = 2
placements = 1
angles = 2
square_mm = 80.0
marker_mm = 60.0
dictionary = "DICT_4X4_50"
[[laser]]
name = "red"
baseline_m = 0.3
crossing_m = 2.0
[turntable]
direction = [0.0, -1.0, 0.0]
point_m = [0.1, 0.0, -0.1]
[room]
size_m = [3.2, 3.8, 2.4]
rig_m = [1.5, 1.8, 1.2]
furniture = false
"""


def make_corpus(tiny: Path, folder: Path, configs: Path) -> None:
    """Files of every format from a rig that went the whole way (`tests/conftest.py`).

    Args:
        tiny: Folder of that rig.
        folder: To make; it must not exist.
        configs: The project's folder of configurations.
    """
    from jaxscan.cli.main import main

    folder.mkdir(parents=True)
    for name in ("calibration.json", "calibration.npz"):
        shutil.copy(tiny / name, folder / name)
    pictures = folder / "pictures"
    assert main(["convert", str(tiny / "captures" / "sweep"), str(pictures), "--storage", "png"]) == 0
    _thinned(pictures, folder / "unsealed", RECORDS, plain=True)
    # Views that overlap, so that images say how far the table turned.
    _thinned(pictures, folder / "turning", RECORDS, plain=True, spread=False)
    shutil.rmtree(pictures)
    _thinned(tiny / "captures" / "boards", folder / "boards", VIEWS, plain=True)
    # A capture is sealed when it is copied into another storage.
    assert main(["convert", str(folder / "unsealed"), str(folder / "shards"), "--storage", "npy"]) == 0
    assert main(["convert", str(folder / "shards"), str(folder / "sealed"), "--storage", "zstd"]) == 0
    reconstruct = ["reconstruct", str(folder / "unsealed"), "-c", str(folder / "calibration.json")]
    assert main([*reconstruct, "--no-cache", "-o", str(folder / "cloud.npz")]) == 0
    assert main([*reconstruct, "-o", str(folder / "cloud.ply"), "--json", str(folder / "reconstruct.json")]) == 0
    for suffix in [one for one in FORMATS if one not in (".npz", ".ply")]:
        assert main(["convert", str(folder / "cloud.ply"), str(folder / f"cloud{suffix}")]) == 0
    # A note on an unchanged capture would hide that a change is not noticed.
    assert json.loads((folder / "reconstruct.json").read_text())["notes"] == []
    (folder / "unsealed" / "stripes.npz").rename(folder / "stripes.npz")
    for number, stranger in enumerate(STRANGERS):
        stranger.write(folder / f"stranger-{number:02d}{stranger.suffix}")
    (folder / "rig.toml").write_text(RIG)
    (folder / "targets.toml").write_text(TARGETS)
    (folder / "known.toml").write_text(KNOWN)
    for name in ("scan.toml", "desk.toml"):
        shutil.copy(configs / name, folder / name)
    panorama = ["panorama", str(folder / "unsealed"), "-c", str(folder / "calibration.json"), "--width", "128"]
    assert main([*panorama, "-o", str(folder / "panorama.jpg")]) == 0
    for name, codec in (("film.avi", "MJPG"), ("film.mp4", "mp4v")):
        _filmed(folder / "unsealed" / "on", folder / name, codec)


def _filmed(pictures: Path, path: Path, codec: str) -> None:
    """A video of all pictures of a folder, in the order of their names."""
    import cv2

    frames = [cv2.resize(cv2.imread(str(picture)), (64, 48)) for picture in sorted(pictures.iterdir())]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10.0, (64, 48))
    assert film.isOpened()
    for frame in frames:
        film.write(frame)
    film.release()


def _thinned(source: Path, target: Path, count: int, *, plain: bool, spread: bool = True) -> None:
    """A capture of `count` records of another, over all of them or the first ones; `plain`: without digests, events."""
    target.mkdir()
    header = re.sub(r"(?m)^steps = \d+$", f"steps = {count}", (source / "capture.toml").read_text())
    (target / "capture.toml").write_text(header)
    records = [json.loads(line) for line in (source / "frames.jsonl").read_text().splitlines()]
    records = [record for record in records if "i" in record]
    last = len(records) - 1 if spread else count - 1
    chosen = [records[k] for k in np.linspace(0, last, count).astype(int)]
    for number, record in enumerate(chosen):
        if plain:
            record.pop("sha256", None)
        for side in ("on", "off"):
            if record.get(side):
                (target / side).mkdir(exist_ok=True)
                shutil.copy(source / record[side], target / side)
        record["i"] = number
    (target / "frames.jsonl").write_text("".join(json.dumps(record) + "\n" for record in chosen))
