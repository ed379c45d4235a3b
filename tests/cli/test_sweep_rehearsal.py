"""The made-up sweep on which a reconstruction is rehearsed, and what the demo does in other processes."""

import json
import subprocess
import sys
import warnings
from dataclasses import asdict

import jax
import numpy as np
import pytest

import jaxscan
from jaxscan.api import simulate_sweep
from jaxscan.api.sweep_rehearsal import RECORDS, WALL_M, ExpectedSweep, made_up_sweep, rehearse_reconstruction
from jaxscan.cli.process import apart
from jaxscan.errors import CaptureError
from jaxscan.reconstruction import reconstruct
from jaxscan.stripes import LaserLine


@pytest.mark.parametrize(("pixel_format", "axis"), [("rgb8", "rows"), ("mono8", "columns")])
def test_its_wall_is_reconstructed(pixel_format, axis):
    """A rehearsal that is refused compiles nothing, and nobody is told: so it must not be."""
    expected = ExpectedSweep((96, 80), pixel_format, LaserLine("line", "red", axis), 500)
    sweep, scanner = made_up_sweep(expected)
    assert len(sweep) == RECORDS and sweep.image_size == (96, 80) and sweep.pixel_format == pixel_format
    cloud = reconstruct(sweep, scanner)
    valid = np.asarray(cloud.valid)
    assert valid.mean() > 0.8
    # The camera of the first record looks along x, from 5 cm before the axis.
    far = np.asarray(cloud.xyz)[0][valid[0], 0]
    assert np.median(far) == pytest.approx(WALL_M + 0.05, abs=0.02)


def test_the_rehearsal_goes_to_its_end():
    rehearse_reconstruction(ExpectedSweep((96, 80), "rgb8", LaserLine("line", "red", "rows"), 500))


EXPECTED = ExpectedSweep((96, 80), "rgb8", LaserLine("line", "red", "rows"), 500)


class TestApart:
    def test_code_is_compiled_once_by_another_process(self, kept, monkeypatch):
        monkeypatch.setattr(apart, "rehearse_reconstruction", lambda _: pytest.fail("compiled by this process"))
        apart.rehearse_apart(EXPECTED)
        (note,) = kept.glob("compiled-*")
        assert "'rgb8'" in note.read_text() and len(list(kept.iterdir())) > 5
        monkeypatch.setattr(apart.subprocess, "Popen", lambda *_, **__: pytest.fail("compiled again"))
        apart.rehearse_apart(EXPECTED)

    def test_a_sweep_that_is_refused_leaves_no_note(self, kept):
        apart.rehearse_apart(EXPECTED._replace(image_size=(0, 0)))
        assert not list(kept.glob("compiled-*"))

    def test_without_a_cache_this_process_compiles(self, kept, monkeypatch):
        done = []
        monkeypatch.setattr(apart, "rehearse_reconstruction", done.append)
        jax.config.update("jax_compilation_cache_dir", None)
        apart.rehearse_apart(EXPECTED)
        assert done == [EXPECTED]

    def test_the_process_ends_with_its_parent(self):
        fields = json.dumps(EXPECTED._asdict() | {"line": asdict(EXPECTED.line)})
        words = [sys.executable, "-P", "-m", "jaxscan.cli.process.apart", "rehearse", fields]
        with subprocess.Popen(words, stdin=subprocess.PIPE) as process:
            assert process.stdin is not None
            process.stdin.close()
            # At the end of its work it would be 0.
            assert process.wait(60) == 1


@pytest.fixture(scope="module")
def config(tiny):
    config = jaxscan.load_simulation(tiny.config)
    return config.model_copy(update={"plan": config.plan.model_copy(update={"steps": 3})})


class TestSweepApart:
    def test_its_frames_are_those_of_this_process(self, config, tmp_path):
        told = []
        with apart.sweep_apart(config, tmp_path) as finish:
            finish(lambda *pairs: told.append(pairs))
        here = tmp_path / "here"
        here.mkdir()
        assert simulate_sweep(config, here) == 3 and told == [(1, 3), (2, 3), (3, 3)]
        for name in ("on/000002.zst", "off/000000.zst"):
            assert (tmp_path / "sweep" / name).read_bytes() == (here / "sweep" / name).read_bytes()
        ours, others = (json.loads((folder / "truth.json").read_text()) for folder in (here, tmp_path))
        assert ours["configuration"] == others["configuration"] and ours.keys() == others.keys()

    def test_a_folder_that_refuses_is_said_in_one_line(self, config, tmp_path):
        (tmp_path / "file").touch()
        with (
            pytest.raises(CaptureError, match=r"file.*sweep.*cannot be written: Not a directory") as caught,
            apart.sweep_apart(config, tmp_path / "file") as finish,
        ):
            finish(lambda *_: None)
        assert "\n" not in str(caught.value)

    def test_a_defect_is_not_taken_for_bad_input(self, config, tmp_path):
        config = config.model_copy(update={"seed": "none"})
        with (
            pytest.raises(RuntimeError, match="ended with code 1: ValidationError 1 validation"),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")  # Of the seed that is no number.
            with apart.sweep_apart(config, tmp_path) as finish:
                finish(lambda *_: None)

    def test_an_error_of_this_process_ends_the_other(self, config, tmp_path):
        with pytest.raises(ZeroDivisionError), apart.sweep_apart(config, tmp_path):
            (process,) = apart.running
            raise ZeroDivisionError
        assert process.returncode is not None and not apart.running

    def test_a_signal_ends_it(self, config, tmp_path):
        with apart.sweep_apart(config, tmp_path):
            (process,) = apart.running
            apart.end_processes()
            assert process.returncode is not None
