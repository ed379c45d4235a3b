"""LAS files whose steps of the coordinates mirror or squash the cloud."""

import struct

import pytest

import jaxscan
from jaxscan.errors import CloudError

from .clouds import make_cloud


SCALES = 131
"""Where the header has the steps of x, y and z."""


@pytest.mark.parametrize("step", [-0.001, 0.0, float("nan"), float("inf"), 1e6])
@pytest.mark.parametrize("axis", [0, 2])
def test_steps_that_are_none_are_refused(step, axis, tmp_path):
    pytest.importorskip("laspy")
    path = tmp_path / "room.las"
    jaxscan.save_cloud(make_cloud(), path)
    jaxscan.load_cloud(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, SCALES + 8 * axis, step)
    path.write_bytes(data)
    with pytest.raises(CloudError, match="not a readable LAS file: .*(mirror or squash|not finite)"):
        jaxscan.load_cloud(path)
