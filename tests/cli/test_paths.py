"""No output is an input or another output, also under another name, as a link or as a hard link."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from jaxscan.cli.options import check_paths
from jaxscan.errors import OptionError
from jaxscan.vision import encode_png

from ..files.clouds import make_cloud
from ..files.conftest import BOARD, Folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with files of every kind that verbs read; none is opened, since names are looked at first."""
    monkeypatch.chdir(tmp_path)
    for name in ("a.ply", "b.ply", "cal.json", "cal.npz", "rig.toml", "old.html"):
        Path(name).write_text(f"content of {name}")
    for name in ("sweep", "boards"):
        made = Folder(tmp_path / name)
        if name == "boards":
            made.header("calibration", rest='[[laser]]\nname = "red"\n' + BOARD)
        for i in range(3):
            made.record(i)
    os.symlink("a.ply", "link.ply")
    os.link("a.ply", "hard.ply")
    os.link("sweep/on/000001.png", "picture.png")
    Path("inner").mkdir()
    os.symlink("sweep", "same")
    return tmp_path


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(
    "words",
    [
        "convert a.ply a.ply",
        "convert a.ply link.ply",
        "convert a.ply hard.ply",
        "convert a.ply new.npz --json a.ply",
        "convert a.ply new.npz --json new.npz",
        "convert cal.json cal.json --format opencv",
        "convert cal.json new.yaml --json cal.npz",
        "convert cal.json cal.npz --format opencv",
        "convert sweep sweep --storage npy",
        "convert sweep same --storage npy",
        "convert sweep new --storage npy --json same/on/000000.png",
        "report cal.json -o cal.json",
        "report cal.json -o old.html --json old.html",
        "reconstruct sweep -c cal.json -o a.ply --json a.ply",
        "reconstruct sweep -c cal.json -o sweep/stripes.npz",
        "reconstruct sweep -c cal.json -o same/stripes.npz",
        "reconstruct sweep -c cal.json -o new.ply --json sweep/capture.toml",
        "reconstruct sweep -c cal.json -o new.ply --json picture.png",
        "reconstruct sweep -c sweep/stripes.npz -o new.ply",
        "init scan.toml -o new.toml --json new.toml",
        "align a.ply -o a.ply --room",
        "align a.ply -o rig.toml --targets rig.toml",
        "board rig.toml -o rig.toml",
        "board boards -o boards/capture.toml",
        "calibrate boards -o c.json --report c.json",
        "calibrate boards -o c.json --report c.npz",
        "calibrate boards -o boards/capture.toml",
        "calibrate boards -o c.json --report boards/frames.jsonl",
        "recalibrate sweep -c cal.json -o cal.json",
        "recalibrate sweep -c cal.json -o new.json --report cal.npz",
        "recalibrate sweep -c cal.json -o new.json --cloud new.ply --report new.ply",
        "recalibrate sweep --boards boards -c cal.json -o boards/capture.toml",
        "recalibrate sweep -c cal.json -o new.json --cloud sweep/stripes.npz",
        "recalibrate sweep -c cal.json -o new.json --known rig.toml --json rig.toml",
        "simulate rig.toml -o made --json rig.toml",
        "scan rig.toml -o sweep --resume --json sweep/frames.jsonl",
        "scan rig.toml -o made -c cal.json --cloud new.ply --json new.ply",
        "doctor --config rig.toml --json rig.toml",
        "measure room a.ply --json hard.ply",
        "measure compare b.ply a.ply --json a.ply",
        "measure room a.ply -c cal.json --json cal.json",
    ],
)
def test_every_verb_refuses(words, here, refused):
    before = contents(here)
    says = refused(*words.format(here=here).split())
    assert "lost" in says or "kept" in says
    assert contents(here) == before


@pytest.mark.parametrize("name", ["calibration.json", "calibration.npz", "room.ply", "room.png"])
def test_the_demo_refuses(name, here, refused):
    Path("demo/captures").mkdir(parents=True)
    Path("demo/captures/truth.json").write_text("{}")
    assert "lost" in refused("demo", "-o", "demo", "--json", f"demo/{name}")
    assert "lost" in refused("demo", "-o", "demo", "--json", "inner/../demo/captures/truth.json")
    os.symlink(f"captures/{'truth.npz' if name == 'room.ply' else 'truth.json'}", f"demo/{name}")
    assert "lost" in refused("demo", "-o", "demo")


@pytest.mark.parametrize(
    ("reads", "writes"),
    [
        ([], ["a.ply", "b.ply"]),
        (["a.ply"], ["b.ply", "new.ply"]),
        # A former result, kept inside the capture from which it was made.
        (["sweep/"], ["sweep/old.ply", "sweep/result.json", "sweep/on/new.ply", "old.html"]),
        (["sweep/", "cal.json"], ["sweep.ply", "cal.html"]),
        (["a.ply"], ["-"]),
    ],
)
def test_others_are_accepted(reads, writes, here):
    Path("sweep/old.ply").write_text("old")
    check_paths({"INPUT": reads}, {"--output": writes})


@pytest.mark.parametrize(
    "name", ["sweep/room.ply", "same/room.ply", "sweep/deep/on/new.ply", "sweep/new.ply", "sweep/here.ply", "mine.ply"]
)
def test_links_in_a_capture_are_not_followed(name, here, refused, tmp_path_factory):
    """Whoever made the capture chose where they lead."""
    others = tmp_path_factory.mktemp("others")
    (others / "room.ply").write_text("of the user")
    os.symlink(others / "room.ply", "sweep/room.ply")
    os.symlink(others, "sweep/deep")
    Path(others, "on").mkdir()
    os.symlink(others / "new.ply", "sweep/new.ply")
    os.symlink("old.ply", "sweep/here.ply")
    os.symlink("sweep/room.ply", "mine.ply")
    before = contents(here) | contents(others)
    says = "is a link in the folder of a capture, which may lead anywhere"
    assert says in refused("reconstruct", "sweep", "-c", "cal.json", "-o", name)
    assert says in refused("reconstruct", "sweep", "-c", "cal.json", "-o", "new.ply", "--json", here / name)
    assert contents(here) | contents(others) == before


def test_links_of_the_user_are_followed(here):
    """Also in a circle, and also to the capture."""
    os.symlink("turn.ply", "round.ply")
    os.symlink("round.ply", "turn.ply")
    os.symlink("sweep/old.ply", "mine.ply")
    for name in ("link.ply", "same/old.ply", "mine.ply", "round.ply"):
        check_paths({"CAPTURE": "same"}, {"--output": name})


def test_the_cache_does_not_replace_the_observations_of_a_calibration(here):
    with pytest.raises(OptionError, match="is the file in which the stripes are kept"):
        check_paths({"--calibration": "sweep/stripes.json"}, kept={"the stripes": "sweep/stripes.npz"})


@pytest.mark.parametrize("name", ["n" * 300 + ".ply", "x" * 5000 + "/a.ply"])
@pytest.mark.parametrize(
    "words",
    [
        "convert a.ply {name}",
        "calibrate boards -o {name}.json",
        "measure room a.ply --json {name}",
        "calibrate {name} -o c.json",
    ],
)
def test_a_name_that_is_too_long(words, name, here, refused):
    before = contents(here)
    assert "longer than the disk allows" in refused(*words.format(name=name).split())
    assert contents(here) == before


@pytest.mark.parametrize(
    "words",
    [["convert", "a.ply", "b\0.npz"], ["calibrate", "boards", "-o", "c\0.json"], ["simulate", "rig.toml", "-o", "\0"]],
)
def test_a_name_with_nul(words, here, refused):
    assert "no name that a file can have" in refused(*words)


class TestTheSameCaptureTwice:
    def calibrate(self, refused, other):
        return refused("calibrate", "boards", str(other), "-o", "c.json")

    def test_under_one_name(self, here, refused):
        assert "is the same capture as boards" in self.calibrate(refused, "boards")

    def test_as_a_link(self, here, refused):
        os.symlink("boards", "linked")
        assert "is the same capture as boards" in self.calibrate(refused, "linked")

    def test_as_a_copy(self, here, refused):
        shutil.copytree("boards", "copied")
        assert "is the same capture as boards" in self.calibrate(refused, "copied")

    def test_equal_texts_with_other_images_are_not_the_same(self, here, refused):
        shutil.copytree("boards", "other")
        for path in sorted(Path("other").rglob("*.png")):
            path.write_bytes(encode_png(np.full((4, 6), 9, np.uint8)))
        assert "is the same capture" not in self.calibrate(refused, "other")


def test_json_holds_names_that_are_not_utf8(here, run):
    jaxscan.save_cloud(make_cloud(), here / "cloud.ply")
    name = os.fsdecode(b"caf\xe9\x1b.ply")
    os.rename("cloud.ply", name)
    ran = run("convert", name, "new.npz", "--json", "-")
    assert ran.code == 0, ran
    assert ran.out.isascii() and json.loads(ran.out)["source"] == name
    points = json.loads(ran.out)["points"]
    assert run("convert", name, os.fsdecode(b"\xe9.npz")).out == f"written: \\udce9.npz ({points} points)\n"
