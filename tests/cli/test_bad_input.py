"""Bad input ends in one line with the finding, and leaves no half-written files."""

import json
import re
import shutil
from contextlib import contextmanager

import numpy as np
import pytest

import jaxscan
from jaxscan import api
from jaxscan.reconstruction import PointCloud


def journal(capture, change):
    """Rewrite a capture's journal record by record; None drops a record."""
    path = capture / "frames.jsonl"
    records = [change(json.loads(line)) for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps(record) + "\n" for record in records if record is not None))


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.fixture
def reconstruct(tiny, tmp_path, refused):
    """Reconstruction that must be refused and leave nothing behind."""

    def call(capture, *words, calibration=tiny.calibration, output=tmp_path / "out" / "a.ply"):
        (tmp_path / "out").mkdir(exist_ok=True)
        message = refused("reconstruct", capture, "-c", calibration, "-o", output, *words)
        assert list((tmp_path / "out").iterdir()) == []
        return message

    return call


@pytest.fixture
def calibrate(tmp_path, refused):
    """Calibration that must be refused and leave nothing behind."""

    def call(*words):
        (tmp_path / "out").mkdir(exist_ok=True)
        message = refused("calibrate", *words, "-o", tmp_path / "out" / "a.json")
        assert list((tmp_path / "out").iterdir()) == []
        return message

    return call


def planned(capture):
    """The parts that would be solved and the one sentence about the others; no image is read, since none can be."""
    for image in capture.glob("*/*.zst"):
        image.write_bytes(b"no picture")
    rig = api.plan_calibration([jaxscan.open_capture(capture)])
    (message,) = rig.missing
    assert "\n" not in message
    return rig.words(), message


def without_laser(boards):
    text = (boards / "capture.toml").read_text()
    (boards / "capture.toml").write_text(re.sub(r"\[\[laser\]\]\n(\w+ = .*\n)+", "", text))
    journal(boards, lambda record: {**record, "on": None, "lasers": []})


def cut(name, bytes_left):
    """Leaves the beginning of a file."""
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:bytes_left])


SWEEPS = {
    "a truncated image": (cut("off/000011.zst", 3000), ["off/000011.zst"]),
    "no stripe": (
        lambda sweep: journal(sweep, lambda record: {**record, "on": record["off"]}),
        ["No stripe was found", "laser was lit"],
    ),
    "another table": (
        lambda sweep: edit(sweep / "capture.toml", 'carries = "scanner"', 'carries = "object"'),
        ["carries the object"],
    ),
}
BOARDS = {
    "a truncated image": (cut("off/000002.zst", 3000), ["off/000002.zst"]),
    "another board": (
        lambda boards: (
            edit(boards / "capture.toml", "columns = 7", "columns = 9"),
            journal(boards, lambda record: record if record["i"] < 4 else None),
        ),
        ["found in none of 4 records", "9 x 5 inner corners"],
    ),
    "two views": (lambda boards: journal(boards, lambda record: record if record["i"] < 2 else None), ["2 view"]),
}
PARTS = {
    "no laser images": (
        lambda boards: journal(boards, lambda record: {**record, "on": None}),
        "camera and axis",
        ["laser on and off", "'red'"],
    ),
    "no laser in the header": (
        without_laser,
        "camera and axis",
        ["lists no [[laser]]", "capture each board pose with the laser on and off"],
    ),
    "one table angle": (
        lambda boards: journal(boards, lambda record: {**record, "angle_deg": 0.0}),
        "camera and sheet",
        ["two table angles", "turn the table between images"],
    ),
}


@pytest.mark.parametrize("name", SWEEPS)
def test_a_sweep_that_cannot_be_used(sweep, reconstruct, name):
    damage, says = SWEEPS[name]
    damage(sweep)
    message = reconstruct(sweep)
    assert all(words in message for words in says)


@pytest.mark.parametrize("name", BOARDS)
def test_boards_that_cannot_be_used(boards, calibrate, name):
    damage, says = BOARDS[name]
    damage(boards)
    message = calibrate(boards)
    assert all(words in message for words in says)


@pytest.mark.parametrize("name", PARTS)
def test_parts_that_boards_do_not_tell(boards, name):
    damage, parts, says = PARTS[name]
    damage(boards)
    found, message = planned(boards)
    assert found == parts and all(words in message for words in says)


def test_torn_last_line_is_dropped_and_said(sweep, run):
    path = sweep / "frames.jsonl"
    path.write_bytes(path.read_bytes()[:-20])
    ran = run("info", sweep)
    assert ran.code == 0 and ran.err == ""
    assert re.search(r"^note: .*line 60: .*left out", ran.out, re.MULTILINE) and "records: 59" in ran.out


def test_captures_of_another_kind(tiny, boards, calibrate, reconstruct):
    assert "is a sweep; a calibration needs captures of a board" in calibrate(tiny.sweep)
    assert "is a calibration capture; only a sweep can be reconstructed" in reconstruct(tiny.boards)
    edit(boards / "capture.toml", "square_mm = 80.0", "square_mm = 81.0")
    assert "its [board] is not the same" in calibrate(tiny.boards, boards)
    says = "is an address, expected a path on a disk; copy it to a disk first, such as with aws s3 sync"
    assert says in reconstruct("s3://rooms/hall")
    assert "at least one capture" in calibrate()


def test_calibrations_that_do_not_fit(tiny, sweep, reconstruct, tmp_path):
    text = json.loads(tiny.calibration.read_text())
    text["camera"] |= {"width": 640, "height": 512}
    # As a person writes it: with digests, the change would be noted.
    del text["digests"]
    (tmp_path / "other.json").write_text(json.dumps(text))
    message = reconstruct(sweep, calibration=tmp_path / "other.json")
    assert "640 x 512" in message and "320 x 256" in message
    (tmp_path / "bad.json").write_bytes(tiny.calibration.read_bytes()[:1500])
    assert "bad.json: line" in reconstruct(tiny.sweep, calibration=tmp_path / "bad.json")


class TestOutput:
    """Where nothing can be written, no work is done."""

    @pytest.fixture(autouse=True)
    def _no_work(self, monkeypatch):
        def work(*words, **options):
            raise AssertionError("worked before it looked where to write")

        for name in ("open_capture", "read_cloud", "load_simulation"):
            monkeypatch.setattr(f"jaxscan.api.{name}", work)

    def test_unknown_suffix(self, tiny, reconstruct, refused, tmp_path):
        message = reconstruct(tiny.sweep, output=tmp_path / "out" / "a.stl")
        assert '".stl"' in message and ".ply" in message
        assert '".stl"' in refused("convert", tiny.cloud, tmp_path / "a.stl")

    def test_missing_folder(self, tiny, reconstruct, refused, tmp_path):
        nowhere = tmp_path / "nowhere"
        assert "create it first" in reconstruct(tiny.sweep, output=nowhere / "a.ply")
        assert "create it first" in refused("calibrate", tiny.boards, "-o", nowhere / "a.json")
        assert "create it first" in refused("convert", tiny.cloud, nowhere / "a.ply")
        assert not nowhere.exists()

    def test_a_file_instead_of_a_folder(self, tiny, reconstruct):
        assert "does not exist" in reconstruct(tiny.sweep, output=tiny.cloud / "a.ply")

    def test_a_folder_instead_of_a_file(self, tiny, refused, tmp_path):
        (tmp_path / "a.ply").mkdir()
        message = refused("reconstruct", tiny.sweep, "-c", tiny.calibration, "-o", tmp_path / "a.ply")
        assert "not a regular file" in message

    def test_a_folder_that_cannot_be_written(self, tiny, refused, tmp_path, monkeypatch):
        # Nothing is forbidden to root, so the system's answer is replaced.
        monkeypatch.setattr("jaxscan.files.disk.writing.os.access", lambda *asked: False)
        for words in (
            ["reconstruct", tiny.sweep, "-c", tiny.calibration, "-o", tmp_path / "a.ply"],
            ["calibrate", tiny.boards, "-o", tmp_path / "a.json"],
        ):
            assert "Permission denied" in refused(*words)

    def test_a_calibration_is_json(self, tiny, refused, tmp_path):
        assert "end its name in .json" in refused("calibrate", tiny.boards, "-o", tmp_path / "a.npz")

    def test_json_into_a_missing_folder(self, tiny, refused, tmp_path):
        nowhere = ("--json", tmp_path / "nowhere" / "a.json")
        assert "create it first" in refused("simulate", tiny.config, "-o", tmp_path / "a", *nowhere)
        assert "create it first" in refused("measure", "plane", tiny.cloud, "--at", 1, 0, 0, *nowhere)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("reconstruct {sweep} -c {calibration} -o {tmp}/a.ply --every 0", "--every: found 0, expected 1 or more"),
        ("simulate {config} -o {tmp}/s --every -3", "--every: found -3"),
        ("simulate {config} -o {tmp}/s --seed -1", "--seed"),
        ("measure plane {cloud} --at 1 0 0 --radius-mm 0", "--radius-mm"),
        ("measure plane {cloud} --at 1 0 0 --radius-mm nan", "--radius-mm"),
        ("measure plane {cloud} --at nan 0 0", "--at"),
        ("measure distance {cloud} --a 1 0 0 --b 0 inf 0", "--b"),
        ("measure plane {cloud} --at 50 0 0", ""),
        ("measure distance {cloud} --a 50 0 0 --b 1 0 0", ""),
        ("simulate {tmp}/nowhere.toml -o {tmp}/s", "no such file"),
        ("demo -o {config}", "is a file"),
    ],
)
def test_values_without_meaning(tiny, refused, tmp_path, words, says):
    assert says in refused(*words.format(tmp=tmp_path, **tiny._asdict()).split())
    assert list(tmp_path.iterdir()) == []


class TestSimulate:
    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("width = 320", "width = -5", "camera.width"),
            ("width = 320", 'width = "wide"', "camera.width"),
            ("[room]", "[rom]", '"room"'),
            ("rig_m = [1.5", "rig_m = [9.5", "inside the room"),
            ("range_m = [0.7, 1.6]", "range_m = [1.7, 0.6]", "range_m"),
            ("crossing_m = 2.0", "", "sheet"),
            ("seed = 3", "seed = -3", "seed"),
            ("columns = 7", "columns = 1", "columns"),
        ],
    )
    def test_values_without_meaning(self, tiny, refused, tmp_path, old, new, said):
        config = tmp_path / "rig.toml"
        shutil.copy(tiny.config, config)
        edit(config, old, new)
        assert said in refused("simulate", config, "-o", tmp_path / "s")
        assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml"]

    def test_a_folder_that_is_not_empty(self, tiny, refused, tmp_path):
        (tmp_path / "mine.txt").write_text("mine")
        assert "exists and is not empty" in refused("simulate", tiny.config, "-o", tmp_path)
        assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]

    def test_the_folder_one_is_in(self, tiny, refused, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert "is the folder you are in" in refused("simulate", tiny.config, "-o", ".")

    def test_interrupted(self, tiny, run, tmp_path, monkeypatch):
        """Control-C after some pairs: exit code 130, and no folder."""
        from jaxscan.cli import prepare

        @contextmanager
        def interrupting(task):
            def progress(done, total):
                if done == 3:
                    raise KeyboardInterrupt

            yield progress

        monkeypatch.setattr(prepare, "progress_bar", interrupting)
        ran = run("simulate", tiny.config, "-o", tmp_path / "s")
        assert (ran.code, ran.out, ran.err) == (130, "", "jaxscan: interrupted\n")
        assert list(tmp_path.iterdir()) == []


class TestDemo:
    def test_into_a_folder_that_holds_something_else(self, refused, tmp_path):
        (tmp_path / "calibration.json").write_text("mine")
        assert "holds files that are not of a demo" in refused("demo", "-o", tmp_path)
        assert (tmp_path / "calibration.json").read_text() == "mine"
        assert len(list(tmp_path.iterdir())) == 1

    def test_into_captures_of_another_rig(self, tiny, refused, tmp_path):
        (tmp_path / "captures").symlink_to(tiny.boards.parent)
        assert "holds captures of another configuration" in refused("demo", "-o", tmp_path)


class TestClouds:
    def test_truncated(self, tiny, refused, tmp_path):
        (tmp_path / "a.ply").write_bytes(tiny.cloud.read_bytes()[:-1000])
        assert "a.ply" in refused("measure", "room", tmp_path / "a.ply")

    def test_a_room_without_walls(self, refused, tmp_path):
        random = np.random.default_rng(0)
        direction = random.normal(size=(40, 50, 3))
        xyz = 2 * direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        jaxscan.save_cloud(_cloud(xyz), tmp_path / "ball.npz")
        assert "No two opposite walls" in refused("measure", "room", tmp_path / "ball.npz")


def _cloud(xyz):
    grid = xyz.shape[:2]
    flat = np.zeros(grid, np.float32)
    return PointCloud(
        xyz=xyz.astype(np.float32),
        rgb=np.zeros((*grid, 3), np.uint8),
        intensity=flat,
        normals=np.zeros((*grid, 3), np.float32),
        sigma_random=flat + np.float32(1e-3),
        sigma_systematic=flat,
        valid=np.ones(grid, bool),
        record=np.arange(grid[0], dtype=np.int32),
        laser=np.zeros(grid[0], np.int32),
        angle=np.linspace(0, 6, grid[0]),
    )


@pytest.mark.parametrize("text", ["[]", "3", '"a"', "null", "[[", "{", ""])
def test_a_demo_beside_a_truth_that_is_none(text, tmp_path, refused):
    (tmp_path / "demo" / "captures").mkdir(parents=True)
    (tmp_path / "demo" / "captures" / "truth.json").write_text(text)
    assert "truth.json" in refused("demo", "-o", tmp_path / "demo")


@pytest.mark.parametrize(
    "truth",
    [
        {},
        {"room": []},
        {"room": {"distances": 3}},
        {"room": {"distances": [{"name": "a", "from_m": [0, 0, 0]}]}},
        {"room": {"distances": [{"name": "a", "from_m": [0, 0], "to_m": [1, 1, 1]}]}},
        {"room": {"distances": [{"name": "a", "from_m": [0, 0, 0], "to_m": [1, 1, "b"]}]}},
        {"room": {"distances": [{"name": "a", "from_m": [0, 0, 0], "to_m": [1, 1, 1e999]}]}},
    ],
)
def test_a_truth_without_its_lengths(truth, tmp_path):
    from jaxscan.cli.demo import _true_lengths

    path = tmp_path / "truth.json"
    path.write_text(json.dumps(truth))
    with pytest.raises(jaxscan.CaptureError, match=r"truth\.json"):
        _true_lengths(path)
