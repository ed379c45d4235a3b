"""Calibrations on the command line: printed summary, report, and export to other programs."""

import ast
import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

import jaxscan
from jaxscan.api.calibration import with_stops
from jaxscan.calibration import CalibrationSettings, ModelTest, Verdict, calibrate_camera
from jaxscan.calibration.result import GoodTo, LaserLengths, Lengths, LengthSigma
from jaxscan.cli.calibrate import calibration_settings, print_summary
from jaxscan.cli.terminal import console
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Still
from jaxscan.recalibration import RecalibrationSettings


REFUSED = Verdict(
    usable=False,
    good_to=GoodTo(sigma_mm=2.0, statistical_mm=0.5, at_m=2.5, sigma_px=0.3, statistical_px=0.2),
    refused="1 mm were asked",
    tests=(ModelTest("sheet", 90.0, 20, p=1e-9, p_structure=1e-9, effect_mm=1.9, effect_px=0.2),),
    advice=("Look at the sheet.",),
)


@pytest.fixture(scope="module")
def calibrated(tiny, tmp_path_factory):
    """A copy of the calibration and its observations."""
    folder = tmp_path_factory.mktemp("calibrated")
    for suffix in (".json", ".npz"):
        shutil.copy(tiny.calibration.with_suffix(suffix), folder)
    return folder / tiny.calibration.name


def edited(calibrated, folder, change, *, observations=True):
    """A copy of a calibration file with another content."""
    content = json.loads(calibrated.read_text())
    change(content)
    path = folder / "edited.json"
    path.write_text(json.dumps(content))
    if observations:
        shutil.copy(calibrated.with_suffix(".npz"), path.with_suffix(".npz"))
    return path


class TestCalibrate:
    def test_the_json_carries_the_summary(self, tiny):
        result = tiny.results["calibrate"]
        # No limit was set, so none is kept.
        assert result["verdict"]["kind"] in ("plain", "bad", "open")
        rows = {row["name"]: row for row in result["parameters"]}
        scanner = jaxscan.load_scanner(tiny.calibration)
        assert rows["fx"]["value_px"] == float(scanner.camera.fx)
        assert rows["fx"]["sigma_px"] == pytest.approx(float(np.sqrt(scanner.covariance[0, 0])))
        assert rows["laser red: distance"]["value_mm"] == pytest.approx(1e3 * float(scanner.lasers.distance[0]))
        assert result["noise"][0].startswith("Corners: ")

    def test_writes_the_report(self, tiny, run, tmp_path, monkeypatch):
        # The solve is tested elsewhere; here only the page matters.
        stored = jaxscan.load_calibration(tiny.calibration)
        monkeypatch.setattr("jaxscan.api.calibrate", lambda captures, **options: stored)
        page = tmp_path / "a.html"
        ran = run("calibrate", tiny.boards, "-o", tmp_path / "a.json", "--report", page, "--json", "-")
        assert json.loads(ran.out)["report"] == str(page), ran.err
        assert "<h2>Views, worst first</h2>" in page.read_text()
        assert jaxscan.load_scanner(tmp_path / "a.json").laser_names == stored.scanner.laser_names

    def test_prints_the_verdict_last(self, tiny, capsys, monkeypatch):
        # Tables that do not fit are lists.
        monkeypatch.setenv("COLUMNS", "200")
        stored = jaxscan.load_calibration(tiny.calibration)
        quality = dataclasses.replace(
            stored.quality,
            lengths=Lengths((LaserLengths("red", lengths=(LengthSigma("along the stripe", 2.5, 0.3, 0.0534),)),)),
            verdict=REFUSED,
            warnings=("[bold]not markup[/bold]",),
        )
        shown = dataclasses.replace(stored, quality=quality)
        print_summary(console(), shown)
        lines = capsys.readouterr().out.splitlines()
        assert lines[1].split() == "0.053 mm 300 mm along the stripe at 2.5 m".split()
        assert lines[2] == "Board found in 21 of 21 records."
        assert lines[3].startswith("Corners: ") and lines[4].startswith("Stripes: ")
        assert "warning: [bold]not markup[/bold]" in lines
        assert lines[-2] == "to improve it: Look at the sheet."
        assert lines[-1].startswith(
            "Good to only 2.0 mm at 2.5 m. Refused: 1 mm were asked; 1.9 mm of that because the"
        )
        # Tables come only on demand, and before all that matters more.
        print_summary(console(), shown, verbose=True)
        more = capsys.readouterr().out.splitlines()
        assert more[-len(lines) :] == lines and not any("│" in line for line in lines)
        assert any(line.startswith("│ sheet") and "structure" in line for line in more)
        assert any(line.startswith("│ fx, px") for line in more)

    @pytest.mark.parametrize("words", [(), ("--json", "-")])
    def test_what_is_refused_is_written_and_exits_with_1(self, tiny, run, tmp_path, monkeypatch, words):
        stored = jaxscan.load_calibration(tiny.calibration)
        judged = dataclasses.replace(stored, quality=dataclasses.replace(stored.quality, verdict=REFUSED))
        monkeypatch.setattr("jaxscan.api.calibrate", lambda captures, **options: judged)
        # The figures are those of the page above; drawing them is most of the time.
        monkeypatch.setattr("jaxscan.report.drawing.as_svg", lambda figure, name, description: "")
        target, page = tmp_path / "a.json", tmp_path / "a.html"
        ran = run("calibrate", tiny.boards, "-o", target, "--report", page, *words)
        assert ran.code == 1
        last = ran.err.splitlines()[-1]
        assert last.startswith(f"jaxscan: {target}: written, but good to only 2.0 mm at 2.5 m. Refused: 1 mm")
        # It says why, and it is all there for whoever wants to look or to go on.
        assert "Look at the sheet." in ran.out
        assert json.loads(target.read_text())["quality"]["verdict"]["usable"] is False
        assert page.stat().st_size > 0
        if words:
            assert json.loads(ran.out)["verdict"]["kind"] == "bad"

    def test_a_solve_that_did_not_converge_says_so_and_nothing_else(self, tiny, run, tmp_path, monkeypatch):
        few = CalibrationSettings(max_steps=1)
        ended = calibrate_camera(jaxscan.load_calibration(tiny.calibration).observations, settings=few)
        monkeypatch.setattr("jaxscan.api.calibrate", lambda captures, **options: ended)
        target = tmp_path / "a.json"
        ran = run("calibrate", tiny.boards, "-o", target, "--only", "camera", "--json", tmp_path / "result.json")
        assert ran.code == 1
        (line,) = ran.err.splitlines()
        assert line.startswith(f"jaxscan: {target}: written, but not converged. The solve did not converge in 1 step")
        plan, *_, last = ran.out.splitlines()
        assert plan == "solving for camera alone"
        assert last.startswith("Not converged. The solve did not converge in 1 step")
        for diagnosis in ("next:", "to improve it:", "warning:", "Tests", "Parameters", "promise"):
            assert diagnosis not in ran.out
        result = json.loads((tmp_path / "result.json").read_text())
        assert result["quality"]["converged"] is False and result["verdict"]["kind"] == "bad"
        assert json.loads(target.read_text())["quality"]["verdict"]["usable"] is False
        # Solved again with the same few steps, it says so again.
        monkeypatch.setattr("jaxscan.report.drawing.as_svg", lambda figure, name, description: "")
        page = tmp_path / "a.html"
        again = run("report", target, "-o", page, "--json", "-")
        assert again.code == 0 and json.loads(again.out)["reproduced"] is None
        assert "the solve did not converge" in again.err and "<strong>Not converged</strong>" in page.read_text()

    def test_structure_that_is_in_the_sigmas_is_no_failure(self, tiny, run, tmp_path, monkeypatch):
        stored = jaxscan.load_calibration(tiny.calibration)
        usable = dataclasses.replace(REFUSED, usable=True, refused=None)
        judged = dataclasses.replace(stored, quality=dataclasses.replace(stored.quality, verdict=usable))
        given = {}
        monkeypatch.setattr("jaxscan.api.calibrate", lambda captures, **options: given.update(options) or judged)
        limits = "--limit-mm 3 --at-m 2.5 --limit-px 0.4".split()
        ran = run("calibrate", tiny.boards, "-o", tmp_path / "a.json", *limits, "--json", tmp_path / "result.json")
        assert ran.code == 0, ran.err
        plan, *_, verdict, following = ran.out.splitlines()
        assert plan == "solving for camera, sheet and axis"
        assert verdict.startswith("Good to 2.0 mm at 2.5 m; 1.9 mm of that because the light sheet does not have")
        assert following == f"next: jaxscan reconstruct captures/room -c {tmp_path / 'a.json'} -o room.ply"
        settings = given["settings"]
        assert (settings.limit_mm, settings.at_m, settings.limit_px) == (3.0, 2.5, 0.4)
        verdict = json.loads((tmp_path / "result.json").read_text())["quality"]["verdict"]
        assert verdict["usable"] is True and verdict["good_to"]["sigma_mm"] == 2.0
        assert verdict["tests"][0]["effect_mm"] == 1.9

    def test_without_an_axis_nothing_is_to_be_reconstructed(self, tiny, run, tmp_path, monkeypatch):
        stored = jaxscan.load_calibration(tiny.calibration)
        usable = dataclasses.replace(REFUSED, usable=True, refused=None)
        judged = dataclasses.replace(
            stored,
            scanner=dataclasses.replace(stored.scanner, turntable=Still(), covariance=None),
            quality=dataclasses.replace(stored.quality, verdict=usable),
            missing=("no axis: no board placement was seen from two table angles",),
        )
        monkeypatch.setattr("jaxscan.api.calibrate", lambda captures, **options: judged)
        monkeypatch.setattr("jaxscan.api.save_calibration", lambda result, output: None)
        ran = run("calibrate", tiny.boards, "-o", tmp_path / "a.json")
        assert ran.code == 0, ran.err
        assert "no axis" in ran.out and "reconstruct" not in ran.out
        assert ran.out.splitlines()[-1].startswith("next: jaxscan report")

    def test_how_well_a_table_stops_is_read_from_the_header(self, tiny, tmp_path, monkeypatch):
        boards = tmp_path / "boards"
        shutil.copytree(tiny.boards, boards)
        header, journal = boards / "capture.toml", boards / "frames.jsonl"
        told = header.read_text()
        # Without the seal, which is broken by another header.
        journal.write_text("".join(line for line in journal.read_text().splitlines(True) if '"event"' not in line))
        given = []
        for name in ("look_at_boards", "to_observations"):
            monkeypatch.setattr(f"jaxscan.api.calibration.{name}", lambda *_, **__: None)

        def estimate(observations, *, settings, **others):
            given.append(settings.angle_sigma)
            raise CalibrationError("enough")

        monkeypatch.setattr("jaxscan.api.calibration.estimate", estimate)
        other = told.replace("[turntable]", "[turntable]\nangle_sigma_deg = 0.01")
        own = CalibrationSettings(angle_sigma=1e-3)
        for text, settings, expected in ((told, None, None), (other, None, np.radians(0.01)), (other, own, 1e-3)):
            header.write_text(text)
            with pytest.raises(CalibrationError, match="enough"):
                jaxscan.calibrate(jaxscan.open_capture(boards), settings=settings)
            assert given.pop() == expected
            captures, own_sigma = [jaxscan.open_capture(boards)], None if settings is None else settings.angle_sigma
            assert with_stops(RecalibrationSettings(angle_sigma=own_sigma), captures).angle_sigma == expected
        header.write_text(told.replace("[turntable]", "[turntable]\nposition_sigma_mm = 0.01"))
        with pytest.raises(CaptureError, match=r"position_sigma_mm: found 0\.01 with carries"):
            jaxscan.open_capture(boards)

    def test_a_limit_that_cannot_be_meant(self, tiny, refused, tmp_path):
        assert "limit_mm: found 0, expected" in refused("calibrate", tiny.boards, "-o", tmp_path / "a", "--limit-mm", 0)

    def test_blocks_are_freed_and_held(self):
        settings = calibration_settings("fisheye", ("pitch", "k3"), ("harmonics",))
        usual = CalibrationSettings().free
        assert settings.camera == "fisheye"
        assert set(settings.free) == {*usual, "pitch"} - {"harmonics"}
        assert len(settings.free) == len(usual)

    def test_a_report_that_cannot_be_written_is_refused_before_the_work(self, tiny, refused, tmp_path):
        message = refused("calibrate", tiny.boards, "-o", tmp_path / "a.json", "--report", tmp_path / "no" / "a.html")
        assert "does not exist" in message
        assert list(tmp_path.iterdir()) == []


class TestReport:
    def test_the_stored_parameters_come_out_again(self, calibrated, run, tmp_path):
        page = tmp_path / "a.html"
        ran = run("report", calibrated, "-o", page, "--json", "-")
        assert ran.code == 0, ran.err
        result = json.loads(ran.out)
        assert result["format"] == "jaxscan-report/1"
        assert result["reproduced"] is True
        assert result["report"] == str(page)
        text = page.read_text()
        for title in ("Parameters", "Residuals over the image", "Stripe and table", "Correlations"):
            assert f"<h2>{title}</h2>" in text
        assert "the result agrees with the stored parameters" in text

    def test_changed_parameters_are_called_out(self, calibrated, run, tmp_path, monkeypatch):
        # The figures are those of the page above; drawing them is most of the time.
        monkeypatch.setattr("jaxscan.report.drawing.as_svg", lambda figure, name, description: "")
        path = edited(calibrated, tmp_path, lambda content: content["camera"].update(fx=content["camera"]["fx"] + 1))
        ran = run("report", path, "-o", tmp_path / "a.html", "--json", "-")
        assert ran.code == 0, ran.err
        result = json.loads(ran.out)
        assert result["reproduced"] is False
        (note,) = result["notes"]
        assert "have changed since jaxscan calibrate wrote it" in note
        assert f"\nnote: {note}\n" in ran.err
        assert ran.err.startswith("Not reproduced: ") and "fx is" in ran.err
        assert "Not reproduced: " in (tmp_path / "a.html").read_text()

    def test_without_observations_the_rest_is_shown(self, calibrated, run, tmp_path):
        path = edited(calibrated, tmp_path, lambda content: None, observations=False)
        ran = run("report", path, "-o", tmp_path / "a.html", "--json", "-")
        assert ran.code == 0, ran.err
        assert json.loads(ran.out)["reproduced"] is None
        text = (tmp_path / "a.html").read_text()
        assert "<h2>Parameters</h2>" in text and "<h2>Stripe and table</h2>" not in text

    @pytest.mark.parametrize(
        ("settings", "said"),
        [
            (7, "provenance.settings: found 7, expected a table"),
            ({"free": ["wings"]}, "provenance.settings.free.0: found 'wings'"),
            ({"huber": -1.0}, "must be above 0"),
            ({"max_steps": 10**9}, "max_steps 1 to 10000"),
            ({"priors": {"gain": "wide"}}, "provenance.settings.priors.gain: found 'wide'"),
        ],
    )
    def test_settings_that_cannot_be_meant_are_refused(self, calibrated, refused, tmp_path, settings, said):
        path = edited(calibrated, tmp_path, lambda content: content["provenance"].update(settings=settings))
        assert said in refused("report", path, "-o", tmp_path / "a.html")
        assert not (tmp_path / "a.html").exists()


class TestConvert:
    def test_opencv(self, tiny, run, tmp_path):
        ran = run("convert", tiny.calibration, tmp_path / "a.yaml", "--json", "-")
        assert ran.code == 0, ran.err
        assert json.loads(ran.out)["camera_format"] == "opencv"
        file = cv2.FileStorage(str(tmp_path / "a.yaml"), cv2.FILE_STORAGE_READ)
        assert file.getNode("camera_matrix").mat()[0, 0] == float(jaxscan.load_scanner(tiny.calibration).camera.fx)

    def test_values_changed_by_hand_are_noted(self, calibrated, run, tmp_path):
        assert "note: " not in run("convert", calibrated, tmp_path / "a.yaml").out
        path = edited(calibrated, tmp_path, lambda content: content["camera"].update(fx=content["camera"]["fx"] + 1))
        ran = run("convert", path, tmp_path / "a.yaml", "--json", "-")
        assert ran.code == 0, ran.err
        (note,) = json.loads(ran.out)["notes"]
        assert ran.err.startswith(f"note: {note}\n") and "have changed since jaxscan calibrate wrote it" in note

    def test_ros_and_mrcal(self, tiny, run, tmp_path):
        assert run("convert", tiny.calibration, tmp_path / "a.yaml", "--format", "ros").code == 0
        assert "distortion_model: plumb_bob" in (tmp_path / "a.yaml").read_text()
        assert run("convert", tiny.calibration, tmp_path / "a.cameramodel").code == 0
        assert ast.literal_eval((tmp_path / "a.cameramodel").read_text())["lensmodel"] == "LENSMODEL_OPENCV5"

    def test_what_cannot_be_converted(self, tiny, refused, tmp_path):
        assert "names no format" in refused("convert", tiny.calibration, tmp_path / "a.ply")
        assert "--format: is for calibrations" in refused("convert", tiny.cloud, tmp_path / "a.xyz", "--format", "ros")
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["room", "distance", "compare"])
def test_measures_with_a_calibration_changed_by_hand_are_noted(verb, tiny, calibrated, run, tmp_path):
    path = edited(calibrated, tmp_path, lambda content: content["camera"].update(fx=content["camera"]["fx"] + 1))
    words = {"room": [], "distance": "--a 1.9 0 0 --b -1.9 0 0 --radius-mm 1500".split(), "compare": [tiny.cloud]}[verb]
    for calibration, noted in ((path, True), (calibrated, False)):
        ran = run("measure", verb, tiny.cloud, *words, "-c", calibration, "--json", "-")
        assert ran.code == 0, ran.err
        notes = json.loads(ran.out)["notes"]
        assert [ran.err.startswith(f"note: {note}\n") for note in notes] == [True] * noted
        assert all("have changed since jaxscan calibrate wrote it" in note for note in notes)
