"""The experiments of the paper: figures against a baseline, worlds, and columns that are read out alone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments.paper import page, stage
from experiments.paper.products import RenderedSweep
from experiments.paper.stage import Metric, smaller, windowed, windowed_scanner, world
from jaxscan.simulation import expect_record, make_rig, make_scene, true_scanner


ROOT = Path(__file__).resolve().parents[2]
WINDOW = 10, 60
DRAWN = {f"figure_{number}" for number in range(5, 10)}
"""Experiments with pictures."""


@pytest.fixture(scope="module", params=["kind", "unkind"])
def tiny(request):
    return smaller(world(request.param), 0.05)


@pytest.mark.parametrize(
    ("direction", "value", "worse"),
    [
        ("less", 1.2, False),
        ("less", 1.4, True),
        ("less", 0.1, False),
        ("more", 0.8, False),
        ("more", 0.6, True),
        ("more", 9.0, False),
        ("near", 0.6, True),
        ("near", 1.4, True),
        ("near", 1.2, False),
        ("none", 99.0, False),
        ("less", np.nan, True),
        ("none", np.nan, False),
    ],
)
def test_a_figure_is_worse_in_its_own_direction(direction, value, worse):
    assert Metric("rms", value, "mm", direction).worse_than(1.0, 0.3) is worse


def test_limits_are_kept_and_said():
    assert Metric("z", 0.6, "mm", high=0.6).met() and not Metric("z", 0.61, "mm", high=0.6).met()
    assert Metric("z", 0.9, "", low=0.8, high=1.2).met() and not Metric("z", 0.79, "", low=0.8, high=1.2).met()
    assert not Metric("z", np.nan, "mm").met()
    assert Metric("z", 1.0, "", low=0.8, high=1.2).wanted() == "0.8 ... 1.2"
    assert "MISSED" in stage.line(Metric("z", 0.61, "mm", high=0.6))


def test_the_baseline_keeps_other_experiments(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "BASELINE", tmp_path / "baseline")
    assert stage.load_baseline("kind") == {}
    stage.save_baseline("kind", "a", [Metric("x", 1.0, "mm", "near", 0.5), Metric("gone", 1.0, "mm")])
    stage.save_baseline("kind", "b", [Metric("y", 2.0, "mm", "less", 9.0)])
    stage.save_baseline("kind", "a", [Metric("x", 1.1, "mm", "near", 0.5)])
    stage.save_baseline("quick kind", "a", [Metric("x", 3.0, "mm")])
    # A figure of which less is better may double at most, whatever its tolerance says.
    assert stage.load_baseline("kind") == {"a.x": (1.1, 0.5), "b.y": (2.0, 2.0)}


def test_the_page_shows_both_worlds_and_marks_what_is_missed():
    good, bad = (Metric("z", value, "mm", paper=1.13, high=0.6, label="Z")._asdict() for value in (0.2, 0.7))
    worlds = {name: {"figure_6": {"seconds": 1.0, "metrics": [one]}} for name, one in (("kind", good), ("unkind", bad))}
    assert "| Z | mm | 1.13 | 0.2 | **0.7** | ≤ 0.6 |" in page.page(worlds)


def test_a_smaller_camera_sees_the_same():
    full = true_scanner(world("kind")).camera
    small = true_scanner(smaller(world("kind"), 0.25)).camera
    project = lambda camera: np.asarray(camera.project(np.array([0.1, -0.2, 1.3])))
    np.testing.assert_allclose((project(full) + 0.5) / 4 - 0.5, project(small), atol=1e-9)


def test_columns_that_are_read_alone_are_those_of_the_image(tiny):
    part = windowed(tiny, *WINDOW)
    whole, columns = (expect_record(make_rig(one), make_scene(one), 0.4) for one in (tiny, part))
    inner = slice(WINDOW[0] + 8, WINDOW[1] - 8)
    # Beside the border of the window, the lens's blur has nothing to take light from. In the unkind world it is blended
    # of a few widths, which are those of the window.
    for side in ("off", "laser"):
        whole_side, part_side = getattr(whole, side), getattr(columns, side)
        np.testing.assert_allclose(part_side[:, 8:-8], whole_side[:, inner], atol=0.4)
    assert columns.laser.max() > 20


def test_a_scanner_of_columns_finds_the_same_points(tiny):
    scanner = true_scanner(tiny)
    part = windowed_scanner(scanner, *WINDOW)
    ray = lambda camera, u: np.asarray(camera.unproject(np.array([u, 30.0])))
    np.testing.assert_allclose(ray(part.camera, 15.0), ray(scanner.camera, 15.0 + WINDOW[0]), rtol=1e-9)
    assert part.camera.width == WINDOW[1] - WINDOW[0]


def test_every_reading_of_a_sweep_renders_the_same_frames(tiny):
    seen = []
    sweep = RenderedSweep(tiny, np.array([0.0, 0.5, 1.0]), seed=4, watch=lambda first, on, off: seen.append(first))
    one, two = list(sweep.chunks(2)), list(sweep.chunks(3))
    np.testing.assert_array_equal(np.concatenate([chunk.on for chunk in one]), two[0].on)
    assert seen == [0, 2, 0]
    other = next(RenderedSweep(tiny, np.array([0.0]), seed=5).chunks(1))
    assert (other.on[0] != two[0].on[0]).any()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_quick_set_runs_in_both_worlds(tmp_path):
    """`make experiments QUICK=--quick`: every experiment ends, with finite figures no worse than the baseline."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir)}
    command = [sys.executable, "-m", "experiments.paper", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    for name in ("kind", "unkind"):
        results = json.loads(stage.results_path(tmp_path, name, True).read_text())
        assert list(results) == list(stage.EXPERIMENTS)
        keys = set()
        for experiment, figures in results.items():
            drawn = list(tmp_path.glob(f"{experiment}*_{name}.png"))
            assert bool(drawn) == (experiment in DRAWN), f"{experiment}: pictures {drawn}"
            for one in figures["metrics"]:
                assert np.isfinite(one["value"]), f"{experiment}.{one['key']}"
                keys.add(f"{experiment}.{one['key']}")
        assert keys == set(stage.load_baseline(f"quick {name}"))
