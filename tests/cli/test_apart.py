"""The process in which the demo renders its sweep."""

import json
import subprocess
import sys
import warnings

import pytest

import jaxscan
from jaxscan.api import simulate_sweep
from jaxscan.cli.process import apart
from jaxscan.errors import CaptureError


@pytest.fixture(scope="module")
def config(tiny):
    config = jaxscan.load_simulation(tiny.config)
    return config.model_copy(update={"plan": config.plan.model_copy(update={"steps": 3})})


class TestSweepApart:
    def test_the_process_ends_with_its_parent(self, config, tmp_path):
        fields = {"folder": str(tmp_path), "config": config.model_dump(mode="json")}
        words = [sys.executable, "-P", "-m", "jaxscan.cli.process.apart", json.dumps(fields)]
        with subprocess.Popen(words, stdin=subprocess.PIPE) as process:
            assert process.stdin is not None
            process.stdin.close()
            # At the end of its work it would be 0.
            assert process.wait(60) == 1

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
