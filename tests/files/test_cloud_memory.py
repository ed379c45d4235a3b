"""Memory that clouds take in a command, by the peak of a process of its own."""

import os
import subprocess
import sys

import numpy as np
import pytest

from jaxscan.files.clouds import save_cloud
from jaxscan.files.clouds.points import blocks
from jaxscan.reconstruction import PointCloud


MOST_BYTES = 120
"""A point takes 40 bytes of the cloud itself and what files say of it; the rest is room for blocks."""
LINES = 1000
_RUN = "import sys; from jaxscan.cli.main import main; sys.exit(main())"


def make_cloud(profiles: int, lines: int = LINES) -> PointCloud:
    """A cloud without a hole, on a sphere."""
    random = np.random.default_rng(0)
    normals = random.standard_normal((profiles, lines, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return PointCloud(
        xyz=-2 * normals,
        rgb=random.integers(0, 255, normals.shape, np.uint8),
        intensity=np.full(normals.shape[:2], 90, np.float32),
        normals=normals,
        sigma_random=np.full(normals.shape[:2], 1e-3, np.float32),
        sigma_systematic=np.full(normals.shape[:2], 1e-3, np.float32),
        valid=np.ones(normals.shape[:2], bool),
        record=np.arange(profiles, dtype=np.int32),
        laser=np.zeros(profiles, np.int32),
        angle=np.linspace(0, 6, profiles),
    )


def peak_bytes(*words: str) -> int:
    """Peak of resident memory of a command."""
    child = subprocess.Popen([sys.executable, "-c", _RUN, *words], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0
    return 1024 * used.ru_maxrss


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems count the peak in other units")
@pytest.mark.parametrize("suffix", ["npz", "pcd", "laz", "ptx", "e57"])
def test_a_point_takes_little_memory_on_its_way_through_convert(tmp_path, suffix):
    peaks = {}
    for profiles in (100, 3000):
        source, there = tmp_path / f"{profiles}.ply", tmp_path / f"{profiles}.{suffix}"
        save_cloud(make_cloud(profiles), source)
        to = peak_bytes("convert", str(source), str(there))
        # E57 is read by a library that takes the columns as a whole.
        back = 0 if suffix == "e57" else peak_bytes("convert", str(there), str(tmp_path / "back.ply"))
        peaks[profiles] = np.array([to, back])
    assert ((peaks[3000] - peaks[100]) / (2900 * LINES) <= MOST_BYTES).all()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems count the peak in other units")
def test_a_point_takes_little_memory_on_its_way_through_measure(tmp_path):
    peaks = {}
    for profiles in (100, 3000):
        source = tmp_path / f"{profiles}.ply"
        save_cloud(make_cloud(profiles), source)
        peaks[profiles] = peak_bytes("measure", "plane", str(source), "--at", "2", "0", "0")
    assert (peaks[3000] - peaks[100]) / (2900 * LINES) <= MOST_BYTES


def test_a_single_profile_is_written_in_parts():
    # Clouds of other programs have one profile: parts of whole profiles would be the whole cloud.
    cloud = make_cloud(1, 1000)
    parts = list(blocks(cloud, 300))
    assert [len(part.xyz) for part in parts] == [300, 300, 300, 100]
    np.testing.assert_array_equal(np.concatenate([part.xyz for part in parts]), cloud.xyz[0])
    np.testing.assert_array_equal(np.concatenate([part.row for part in parts]), np.arange(1000))
