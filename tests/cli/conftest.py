"""Fixtures for tests of the command line: running it, and copies of captures to damage."""

import json
import shutil
from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxscan
from jaxscan.cli.main import main
from jaxscan.reconstruction import PointCloud

from ..measurement.rooms import CUPBOARD, DOOR, WINDOW, seen_room


class Ran(NamedTuple):
    """How a verb ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys):
    """`jaxscan` with these words, in this process; usage errors leave by SystemExit, as in a shell."""

    def call(*words):
        capsys.readouterr()
        try:
            code = main([str(word) for word in words])
        except SystemExit as left:
            code = left.code
        captured = capsys.readouterr()
        return Ran(code, captured.out, captured.err)

    return call


@pytest.fixture
def refused(run):
    """The one line on standard error with which a verb refuses."""

    def call(*words):
        ran = run(*words)
        assert ran.code == 1, ran
        # A plan is made from header and journal; results are reported only where the input is known to be good.
        assert all(line.startswith(("solving for ", "no ")) for line in ran.out.splitlines()), ran.out
        assert ran.err.startswith("jaxscan: ") and ran.err.endswith("\n") and ran.err.count("\n") == 1, ran.err
        assert "Traceback" not in ran.err and "Error" not in ran.err
        return ran.err

    return call


def unsealed(folder):
    """A capture without digests and seal, as other software writes it: whatever is damaged is not found by them."""
    lines = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    bare = [{key: value for key, value in line.items() if key != "sha256"} for line in lines if "i" in line]
    (folder / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in bare))
    return folder


@pytest.fixture
def sweep(tiny, tmp_path):
    """A copy of the sweep to damage."""
    return unsealed(shutil.copytree(tiny.sweep, tmp_path / "sweep"))


@pytest.fixture
def boards(tiny, tmp_path):
    """A copy of the board capture to damage."""
    return unsealed(shutil.copytree(tiny.boards, tmp_path / "boards"))


@pytest.fixture
def kept(tmp_path):
    """A folder for compiled code of its own, empty."""
    before, folder = jax.config.values["jax_compilation_cache_dir"], tmp_path / "compiled"
    folder.mkdir()
    jax.config.update("jax_compilation_cache_dir", str(folder))
    yield folder
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture(scope="session")
def room(tmp_path_factory):
    """A room of the shape of an L, as a file."""
    seen = seen_room(niches=(DOOR, WINDOW), boxes=(CUPBOARD,), grid=(240, 80))
    shape = seen.valid.shape
    cloud = PointCloud(
        xyz=seen.xyz,
        rgb=seen.rgb,
        intensity=np.full(shape, 100.0, np.float32),
        normals=np.zeros((*shape, 3), np.float32),
        sigma_random=seen.sigma_random,
        sigma_systematic=np.zeros(shape, np.float32),
        valid=seen.valid,
        record=np.arange(shape[0]),
        laser=seen.laser,
        angle=seen.angle.astype(np.float32),
    )
    path = tmp_path_factory.mktemp("room") / "room.npz"
    jaxscan.save_cloud(cloud, path)
    return path
