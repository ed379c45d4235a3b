"""The made-up sweep on which a reconstruction is rehearsed."""

import json
import subprocess
import sys
from dataclasses import asdict

import jax
import numpy as np
import pytest

from jaxscan.api.sweep_rehearsal import RECORDS, WALL_M, ExpectedSweep, made_up_sweep, rehearse_reconstruction
from jaxscan.cli.process import apart
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
        words = [sys.executable, "-P", "-m", "jaxscan.cli.process.apart", fields]
        with subprocess.Popen(words, stdin=subprocess.PIPE) as process:
            assert process.stdin is not None
            process.stdin.close()
            # At the end of its work it would be 0.
            assert process.wait(60) == 1
