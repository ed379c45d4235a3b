"""The options of `jaxscan reconstruct`, and its output."""

import errno
import json
import os
import shutil

import numpy as np
import pytest

import jaxscan


pytestmark = pytest.mark.more


@pytest.fixture
def capture(tiny, tmp_path):
    """A copy of the sweep of which no stripes are kept yet."""
    return shutil.copytree(tiny.sweep, tmp_path / "sweep", ignore=shutil.ignore_patterns("stripes.npz"))


@pytest.fixture
def reconstruct(tiny, run, tmp_path):
    def call(capture, *words):
        """The printed text, the JSON and the cloud."""
        target, result = tmp_path / "cloud.npz", tmp_path / "result.json"
        ran = run("reconstruct", capture, "-c", tiny.calibration, "-o", target, "--json", result, *words)
        assert ran.code == 0, ran.err
        return ran.out, json.loads(result.read_text()), jaxscan.load_cloud(target)

    return call


def test_stripes_are_kept_and_used_again(tiny, capture, reconstruct):
    out, result, first = reconstruct(capture)
    assert "stripes kept for next time" in out.splitlines()
    # Noise as it was learned is kept with the stripes.
    noise = result["noise"]
    assert noise.startswith("read noise") and f"noise: {noise}" in out.splitlines()
    assert (result["stripes_from_cache"], result["stripes_kept"]) == (False, True)
    out, result, second = reconstruct(capture)
    assert "stripes from the cache" in out.splitlines()
    assert (result["stripes_from_cache"], result["stripes_kept"]) == (True, True)
    assert result["noise"] == noise
    for name in ("xyz", "rgb", "normals", "valid"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name), err_msg=name)
    kept = (capture / "stripes.npz").stat().st_mtime_ns
    out, result, third = reconstruct(capture, "--no-cache")
    assert not any(line.startswith("stripes") for line in out.splitlines())
    assert result["stripes_from_cache"] is result["stripes_kept"] is False
    assert (capture / "stripes.npz").stat().st_mtime_ns == kept
    np.testing.assert_array_equal(third.valid, first.valid)


def test_a_place_that_cannot_be_written_is_a_note(capture, reconstruct):
    (capture / "stripes.npz").mkdir()
    out, result, cloud = reconstruct(capture)
    (note,) = result["notes"]
    assert note.startswith("the stripes are not kept for next time") and cloud.valid.any()
    assert "note: the stripes are not kept" in out and "stripes kept" not in out


def test_a_capture_on_a_read_only_file_system_gives_its_cloud(capture, reconstruct, monkeypatch):
    making = os.open

    def read_only(path, flags, *rest, **keys):
        if flags & os.O_CREAT and str(path).startswith(str(capture)):
            raise OSError(errno.EROFS, "Read-only file system")
        return making(path, flags, *rest, **keys)

    monkeypatch.setattr(os, "open", read_only)
    before = sorted(capture.rglob("*"))
    _, result, cloud = reconstruct(capture)
    (note,) = result["notes"]
    assert note.startswith("the stripes are not kept for next time") and note.endswith("Read-only file system.")
    assert cloud.valid.any() and sorted(capture.rglob("*")) == before


@pytest.mark.parametrize("leads_to", ["victim", "nowhere"])
def test_a_link_in_place_of_the_kept_stripes_is_replaced(capture, reconstruct, tmp_path, leads_to):
    (tmp_path / "victim").write_bytes(b"precious")
    (capture / "stripes.npz").symlink_to(tmp_path / leads_to)
    out, *_ = reconstruct(capture)
    assert "stripes kept for next time" in out.splitlines()
    assert not (capture / "stripes.npz").is_symlink()
    assert (tmp_path / "victim").read_bytes() == b"precious" and not (tmp_path / "nowhere").exists()


def test_all_candidates_are_profiles_of_their_own(tiny, capture, reconstruct):
    _, _, cloud = reconstruct(capture, "--choice", "all", "--no-cache")
    whole = jaxscan.load_cloud(tiny.cloud)
    assert cloud.valid.shape == (3 * len(whole.valid), whole.valid.shape[1])
    assert cloud.valid.sum() >= whole.valid.sum()


def test_a_calibration_that_did_not_converge_is_noted(tiny, capture, run, tmp_path):
    content = json.loads(tiny.calibration.read_text())
    content["quality"]["converged"] = False
    # With digests, the change would be noted too.
    del content["digests"]
    (tmp_path / "ended.json").write_text(json.dumps(content))
    result = tmp_path / "result.json"
    ran = run("reconstruct", capture, "-c", tmp_path / "ended.json", "-o", tmp_path / "a.npz", "--json", result)
    assert ran.code == 0, ran.err
    (note,) = json.loads(result.read_text())["notes"]
    assert "ended.json: its solve did not converge" in note and f"note: {note}" in ran.out.splitlines()


def test_the_range_is_that_of_the_options(tiny, capture, reconstruct):
    _, _, cloud = reconstruct(capture, "--min-range", 1.5, "--max-range", 2.0, "--no-cache")
    scanner, whole = jaxscan.load_scanner(tiny.calibration), jaxscan.load_cloud(tiny.cloud)
    centre = np.stack([np.asarray(scanner.pose(np.asarray(angle)))[:3, 3] for angle in cloud.angle])
    away = np.linalg.norm(cloud.xyz - centre[:, None], axis=-1)[cloud.valid]
    # Rounding of single precision aside.
    assert away.min() > 1.5 - 1e-5 and away.max() < 2.0 + 1e-5
    assert 0.05 * whole.valid.sum() < cloud.valid.sum() < 0.8 * whole.valid.sum()


def test_steps_are_compared(tiny, capture, reconstruct):
    """Nothing is wrong with the tiny room but its corners, where a stripe jumps from step to step."""
    _, _, cloud = reconstruct(capture, "--check-steps", "--no-cache")
    whole = jaxscan.load_cloud(tiny.cloud)
    both = cloud.valid & whole.valid
    assert cloud.valid.shape == whole.valid.shape and both.sum() > 0.9 * whole.valid.sum()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--min-range", "2", "--max-range", "1"), "--max-range: found 1, expected more than --min-range, which is 2"),
        (("--min-range", "-1"), "--min-range: found -1, expected a distance in metres"),
        (("--max-range", "nan"), "--max-range: found nan"),
        (("--check-steps", "--choice", "all"), "--check-steps: found with --choice all"),
    ],
)
def test_options_that_cannot_be_meant(tiny, refused, tmp_path, words, says):
    assert says in refused("reconstruct", tiny.sweep, "-c", tiny.calibration, "-o", tmp_path / "a.ply", *words)
    assert not (tmp_path / "a.ply").exists()


def test_neighbouring_lines_are_used_unless_that_is_switched_off(tiny, capture, reconstruct):
    _, _, smooth = reconstruct(capture)
    out, _, rows = reconstruct(capture, "--smooth", "off")
    assert smooth.shared_lines is not None and rows.shared_lines is None
    # The stripes that were kept are those of the rows, and serve both.
    assert "stripes from the cache" in out
    both = smooth.valid & rows.valid
    assert both.sum() > 0.99 * rows.valid.sum()
    assert np.median(smooth.sigma_random[both]) < 0.6 * np.median(rows.sigma_random[both])


@pytest.mark.parametrize(
    ("option", "value", "known"), [("--choice", "prettiest", "nearest"), ("--smooth", "on", "edge")]
)
def test_an_unknown_way_is_a_usage_error(tiny, run, tmp_path, option, value, known):
    ran = run("reconstruct", tiny.sweep, "-c", tiny.calibration, "-o", tmp_path / "a.ply", option, value)
    assert ran.code == 2 and known in ran.err
