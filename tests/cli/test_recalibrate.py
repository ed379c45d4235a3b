"""`jaxscan recalibrate`: output, files, and bad input in one line that leaves the old calibration as it was."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from jaxscan import api, recalibration
from jaxscan.calibration import Calibration
from jaxscan.cli.main import main
from jaxscan.files.calibration import calibration_digest
from jaxscan.geometry import LaserSheet, LinearStage, Pinhole, Scanner, Turntable
from jaxscan.recalibration import renew_calibration

from ..files.conftest import BOARD, LASER, Folder
from ..report.made_recalibration import make_recalibration


WIDTH, HEIGHT = 6, 4
"""Of the captures that are refused before an image is read."""


def make_scanner(*, motion="turntable", covariance=True, width=WIDTH, height=HEIGHT):
    camera = Pinhole(*(np.asarray(v) for v in (900.0, 900.0, 3.0, 2.0)), np.zeros(5), width=width, height=height)
    sheet = LaserSheet.from_plane(np.array([0.97, 0.0, 0.24]), 0.2)
    table = Turntable.from_axis(np.array([0.0, -1.0, 0.0]), np.array([0.1, 0.0, -0.06]))
    stage = LinearStage.from_direction(np.array([1.0, 0.0, 0.0]))
    moving = {"turntable": table, "object": table.carrying("object"), "linear": stage, "still": None}
    scanner = Scanner.from_parts(camera, sheet, moving[motion], laser_names=["red"])
    if not covariance:
        return scanner
    sigma = np.array([1.0 if name[0] in "fc" else 1e-3 for name in scanner.parameter_names()])
    return dataclasses.replace(scanner, covariance=np.diag(sigma**2))


def save(scanner, path, **provenance):
    covariance = np.zeros((0, 0)) if scanner.covariance is None else scanner.covariance
    order = () if scanner.covariance is None else scanner.parameter_names()
    jaxscan.save_calibration(Calibration(scanner.camera, scanner, order, covariance, provenance=provenance), path)
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Sweeps, boards and an old calibration, good as far as nobody reads the images."""
    monkeypatch.chdir(tmp_path)
    for name in ("room", "boards"):
        made = Folder(tmp_path / name)
        if name == "boards":
            made.header("calibration", rest=LASER + BOARD)
        for i in range(3):
            made.record(i)
    save(make_scanner(), tmp_path / "old.json")
    return tmp_path


@pytest.fixture
def says(here, refused):
    """The line with which a recalibration is refused; it leaves every file as it was."""

    def call(*words, output="new.json"):
        before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
        message = refused("recalibrate", *words, "-o", output)
        assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before
        return message

    return call


class TestBadInput:
    def test_a_capture_of_boards(self, says):
        assert "boards: is a calibration capture, expected a sweep" in says("boards", "-c", "old.json")

    def test_a_sweep_as_boards(self, says):
        assert "room2: is a sweep; a calibration needs" in says_with_second(says)

    def test_the_same_sweep_twice(self, says, here):
        (here / "same").symlink_to("room")
        shutil.copytree("room", "copy")
        for other in ("room", "same", "copy"):
            assert f"{other}: is the same capture as room" in says("room", other, "-c", "old.json")

    def test_captures_that_were_used_already(self, says, here):
        sweep, board = (
            {"name": "renamed", "digest": jaxscan.open_capture(here / name).digest()} for name in ("room", "boards")
        )
        other = {"name": "other", "digest": "sha256:00"}
        save(make_scanner(), here / "new.json", captures=[sweep])
        assert "room: was already used for new.json or" in says("room", "-c", "new.json", output="newer.json")
        save(
            make_scanner(),
            here / "third.json",
            captures=[other],
            earlier=[{"captures": [board]}, {"captures": [sweep]}],
        )
        assert "room: was already used for third.json or" in says("room", "-c", "third.json")
        shutil.copytree("room", "room2")
        Path("room2/frames.jsonl").write_text(Path("room/frames.jsonl").read_text().replace("0.1,", "0.15,"))
        save(make_scanner(), here / "boards.json", captures=[board])
        assert "boards: was already used for boards.json" in says("room2", "-c", "boards.json", "--boards", "boards")
        # A file that a person wrote.
        save(
            make_scanner(width=8), here / "odd.json", captures={"a": 1}, earlier=[3, {"captures": [[], {"digest": 3}]}]
        )
        assert "calibrated for images of 8 x 4 px" in says("room", "-c", "odd.json")

    def test_a_sweep_of_another_camera_size(self, says, here):
        save(make_scanner(width=8), here / "wide.json")
        assert "room: The scanner is calibrated for images of 8 x 4 px, the sweep has 6 x 4 px" in says(
            "room", "-c", "wide.json"
        )

    def test_boards_of_another_camera_size(self, says, here):
        text = Path("boards/capture.toml").read_text()
        Path("boards/capture.toml").write_text(text.replace("width = 6", "width = 7"))
        assert "boards: its images have 7 x 4 px" in says("room", "-c", "old.json", "--boards", "boards")

    def test_a_calibration_without_covariance(self, says, here):
        save(make_scanner(covariance=False), here / "bare.json")
        assert "bare.json: has no covariance, so nothing holds the two scales" in says("room", "-c", "bare.json")

    def test_a_camera_alone(self, says, here):
        camera = make_scanner().camera
        jaxscan.save_calibration(Calibration(camera, None, (), np.zeros((0, 0))), here / "camera.json")
        assert "camera.json: holds a camera alone" in says("room", "-c", "camera.json")

    @pytest.mark.parametrize(("motion", "named"), [("linear", "a linear stage"), ("still", "stands still")])
    def test_a_rig_without_a_table(self, says, here, motion, named):
        save(make_scanner(motion=motion), here / "stage.json")
        assert named in says("room", "-c", "stage.json")

    def test_a_table_that_carries_the_object(self, says, here):
        text = Path("room/capture.toml").read_text()
        Path("room/capture.toml").write_text(text.replace('"scanner"', '"object"'))
        assert "room: The table of the sweep carries the object" in says("room", "-c", "old.json")
        save(make_scanner(motion="object"), here / "object.json")
        message = says("room", "-c", "object.json")
        assert "object.json: is that of a table that carries the object" in message and "with boards" in message

    @pytest.mark.parametrize(
        ("words", "found"),
        [
            ("-c old.json", "No sweep was given"),
            ("room -c old.json --min-range 3 --max-range 2", "--max-range"),
            ("room -c old.json --cloud room.doc", 'cannot write ".doc"'),
            ("room -c old.json --known known.toml", "known.toml: "),
            ("room -c old.json --known none.toml", "none.toml: "),
        ],
    )
    def test_options_without_meaning(self, says, words, found):
        Path("known.toml").write_text("[[length]]\nmetre = 1")
        assert found in says(*words.split())


def says_with_second(says):
    shutil.copytree("room", "room2")
    text = Path("room2/frames.jsonl").read_text()
    Path("room2/frames.jsonl").write_text(text.replace("0.1,", "0.15,"))
    return says("room", "-c", "old.json", "--boards", "room2")


def test_lasers_of_boards_are_known_by_their_names(here, monkeypatch):
    from jaxscan.api.recalibration import _observed
    from jaxscan.errors import CalibrationError

    class Seen:
        laser_names = ("laser1",)

    monkeypatch.setattr("jaxscan.api.recalibration.observe_boards", lambda *_, **__: Seen())
    with pytest.raises(CalibrationError, match=r"boards: found lasers laser1, expected .* \(red, green\)"):
        _observed([jaxscan.open_capture(here / "boards")], ("red", "green"), None)


@pytest.fixture
def recalibrated(here, monkeypatch):
    """The verb with a recalibration that no solve has seen; returns its options as they came."""
    came = {}

    def recalibrate(captures, calibration, **options):
        came.update(options, captures=[capture.path for capture in captures], calibration=calibration)
        made = make_recalibration(api.load_scanner(calibration), updated=came["updated"], drifted=came["drifted"])
        renewed = renew_calibration(made, {"captures": [{"name": "room", "digest": "sha256:00"}], "recalibration": {}})
        # No length is in reach of a camera of 6 x 4 px.
        return dataclasses.replace(renewed, lengths=made.lengths)

    came.update(updated=True, drifted=True)
    monkeypatch.setattr("jaxscan.api.recalibrate", recalibrate)
    return came


class TestOutput:
    def test_the_drift_verdict_comes_last(self, recalibrated, run):
        old = Path("old.json").read_bytes()
        ran = run("recalibrate", "room", "-c", "old.json", "-o", "new.json", "--report", "new.html")
        assert ran.code == 0, ran.err
        lines = ran.out.splitlines()
        assert lines[-4] == "The rig has drifted: the plane of laser red moved by 0.050 degrees (p < 1e-6)."
        # In the figure of `jaxscan calibrate`; the old calibration was written by hand, without a verdict.
        assert re.fullmatch(r"Good to .*(mm at .* m|px over the image), before not known\.", lines[-2])
        assert lines[-1] == "next: jaxscan reconstruct room -c new.json -o room.ply"
        assert "written: new.json, new.html" in lines
        said = " ".join(lines)
        assert "table: The table turns half as far as the journal says." in lines
        assert "6.15 m between points half a turn apart: 63 mm before, 1.1 mm now, 57 times better" in said
        assert "laser red: n1: 0.01 → 0.0109, +9.0 sigmas" in said
        assert not any(line.startswith("  fx:") for line in lines)
        assert "closure after a full turn, at 2.5 m, by the overlap: 4.2 mm before, 0.20 mm now" in said
        assert "not told by these captures: The radial scale is held" in said
        assert Path("old.json").read_bytes() == old
        assert "<h2>Flatness of the walls</h2>" in Path("new.html").read_text()

    def test_no_drift(self, recalibrated, run):
        recalibrated["drifted"] = False
        ran = run("recalibrate", "room", "-c", "old.json", "-o", "new.json")
        *_, verdict, _, _, following = ran.out.splitlines()
        assert verdict == "The rig is as it was calibrated (p = 0.43)."
        assert following == "next: jaxscan reconstruct room -c new.json -o room.ply"

    def test_the_json_carries_the_summary(self, recalibrated, run):
        ran = run("recalibrate", "room", "-c", "old.json", "-o", "new.json", "--json", "-")
        result = json.loads(ran.out)
        assert result["format"] == "jaxscan-recalibrate/1"
        assert result["drift"]["p"] == 1e-9 and result["drift"]["part"] == "laser red"
        assert result["gains"][0]["name"] == "radial scale"
        assert result["lengths"][0] == {
            **{"laser": "red", "name": "along the stripe", "depth_m": 2.5, "length_m": 0.3},
            **{"before_mm": 0.4, "after_mm": 0.05},
        }
        assert result["walls"][0]["after_mm"] < result["walls"][0]["before_mm"]

    def test_nothing_is_written_where_nothing_was_gained(self, recalibrated, says):
        recalibrated.update(updated=False, drifted=False)
        message = says("room", "-c", "old.json", "--cloud", "room.ply")
        assert "old.json: not updated: nothing was gained" in message
        assert "The table turns half as far as the journal says." in message
        assert "The rig is as it was calibrated (p = 0.43)." in message

    def test_options_arrive(self, recalibrated, run):
        words = "--boards boards --stations --no-features --closed --max-range 9"
        assert run("recalibrate", "room", "-c", "old.json", "-o", "new.json", *words.split()).code == 0
        settings = recalibrated["settings"]
        assert (settings.stations, settings.features, settings.closed) == (True, False, True)
        assert settings.stripes.max_range_m == 9
        assert [capture.path for capture in recalibrated["boards"]] == [Path("boards")]
        assert run("recalibrate", "room", "-c", "old.json", "-o", "new.json").code == 0
        assert (recalibrated["settings"].features, recalibrated["settings"].closed) == (None, None)

    def test_the_new_calibration_serves_everywhere(self, recalibrated, run):
        assert run("recalibrate", "room", "-c", "old.json", "-o", "new.json").code == 0
        new, old = jaxscan.load_calibration("new.json"), jaxscan.load_scanner("old.json")
        np.testing.assert_allclose(new.covariance, 0.04 * old.covariance)
        np.testing.assert_array_equal(new.scanner.covariance, new.covariance)
        assert new.quality.verdict.usable is not None and new.quality.converged
        ran = run("report", "new.json", "-o", "new.html")
        assert ran.code == 0 and "Recalibrated from sweeps" in ran.out.splitlines()[0]
        assert run("convert", "new.json", "camera.yaml").code == 0
        assert run("recalibrate", "room", "-c", "new.json", "-o", "newer.json").code == 0


@pytest.fixture(scope="module")
def whole_way(tiny, tmp_path_factory):
    """A small simulated rig that nobody has touched, recalibrated from its sweep: the folder, and how it ended."""
    folder = tmp_path_factory.mktemp("whole")
    shutil.copytree(tiny.sweep, folder / "sweep")
    before = tiny.calibration.read_bytes()
    solve, solved = recalibration.recalibrate, []

    def watched(*inputs, progress):
        solved.append((inputs, solve(*inputs, progress=progress)))
        return solved[0][1]

    written = {"-o": "new.json", "--cloud": "new.ply", "--report": "new.html", "--json": "result.json"}
    options = [word for option, name in written.items() for word in (option, str(folder / name))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recalibration, "recalibrate", watched)
        code = main(["recalibrate", str(folder / "sweep"), "-c", str(tiny.calibration), *options])
    assert tiny.calibration.read_bytes() == before
    (only,) = solved
    return folder, code, only


def test_a_refusal_is_reported_too(here, monkeypatch, refused):
    """The verdict on drift is worth knowing where nothing was gained; calibration and cloud are not written."""
    made = make_recalibration(make_scanner())
    made = dataclasses.replace(made, updated=False, refused="nothing was gained", calibration=None)
    monkeypatch.setattr(api, "recalibrate", lambda *_, **__: made)
    options = "-o new.json --cloud new.ply --report new.html --json result.json".split()
    message = refused("recalibrate", "room", "-c", "old.json", *options)
    assert "old.json: not updated: nothing was gained." in message
    assert json.loads((here / "result.json").read_text())["updated"] is False
    assert "not updated" in (here / "new.html").read_text()
    assert not (here / "new.json").exists() and not (here / "new.ply").exists()


def assert_same(one, other):
    """Equal in every number, of dataclasses in tuples and dictionaries."""
    assert type(one) is type(other)
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, tuple | list):
        for pair in zip(one, other, strict=True):
            assert_same(*pair)
    else:
        np.testing.assert_array_equal(one, other)


@pytest.mark.more
class TestWholeWay:
    def test_a_rig_that_nobody_has_touched(self, whole_way):
        folder, code, _ = whole_way
        assert code == 0
        result = json.loads((folder / "result.json").read_text())
        assert not result["drift"]["drifted"] and result["drift"]["p"] > 1e-3
        assert result["points"] > 100 and result["surfaces"] >= 3
        # A length that is known no worse: rounding leaves less than a hundredth.
        assert all(one["after_mm"] < 1.01 * one["before_mm"] for one in result["lengths"]) and result["lengths"]
        assert min(one["after_mm"] / one["before_mm"] for one in result["lengths"]) < 0.95

    def test_the_new_calibration_says_where_it_is_from(self, whole_way, tiny, refused):
        folder, *_ = whole_way
        new = jaxscan.load_calibration(folder / "new.json")
        told = new.provenance
        assert told["calibration"] == {"name": "calibration.json", "digest": calibration_digest(tiny.calibration)}
        (capture,) = told["captures"]
        assert capture == {"name": "sweep", "digest": jaxscan.open_capture(tiny.sweep).digest()}
        before = jaxscan.load_calibration(tiny.calibration).provenance["captures"]
        assert told["earlier"] == [{"captures": before}] and before
        again = [folder / "sweep", "-c", folder / "new.json", "-o", folder / "newer.json"]
        assert "was already used for" in refused("recalibrate", *again)
        assert told["recalibration"]["drift"]["p"] > 1e-3
        assert told["recalibration"]["settings"]["closed"] is None
        assert new.quality.verdict.usable

    def test_the_cloud_is_that_of_the_new_calibration(self, whole_way, run):
        folder, *_ = whole_way
        words = f"reconstruct {folder / 'sweep'} -c {folder / 'new.json'} -o {folder / 'again.ply'}"
        assert "stripes from the cache" in run(*words.split()).out
        ours, again = (jaxscan.load_cloud(folder / name) for name in ("new.ply", "again.ply"))
        np.testing.assert_array_equal(ours.valid, again.valid)
        np.testing.assert_allclose(ours.xyz, again.xyz, atol=1e-6)

    def test_python_gives_the_same_and_reads_no_image_again(self, whole_way, tiny, monkeypatch):
        """The solve is given the same to the last digit; it is not run again."""
        folder, _, (inputs, solution) = whole_way

        def known(*again, progress):
            assert_same(again, inputs)
            return solution

        monkeypatch.setattr("jaxscan.api.sweeps.extract", None)
        monkeypatch.setattr(recalibration, "recalibrate", known)
        result = jaxscan.recalibrate(jaxscan.open_capture(folder / "sweep"), tiny.calibration)
        new = jaxscan.load_calibration(folder / "new.json")
        np.testing.assert_array_equal(result.calibration.covariance, new.covariance)
        assert float(result.scanner.camera.fx) == float(new.scanner.camera.fx)

    def test_a_sweep_without_planes(self, tiny, tmp_path, refused):
        """Angles that have nothing to do with the images bend every wall."""
        sweep = shutil.copytree(tiny.sweep, tmp_path / "sweep")
        journal = [json.loads(line) for line in (sweep / "frames.jsonl").read_text().splitlines()]
        records = [record for record in journal if "i" in record]
        angles = np.random.default_rng(5).permutation([record["angle_deg"] for record in records])
        for record, angle in zip(records, angles.tolist(), strict=True):
            record["angle_deg"] = angle
        (sweep / "frames.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))
        message = refused("recalibrate", sweep, "-c", tiny.calibration, "-o", tmp_path / "new.json")
        assert f"{sweep}: " in message or "not updated" in message
        assert not (tmp_path / "new.json").exists()
