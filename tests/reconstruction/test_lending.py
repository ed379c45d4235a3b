"""Frames anywhere in memory: lent to the compiled function as they lie, and the same result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.reconstruction.ahead import Lender
from jaxscan.stripes import NoiseModel
from jaxscan.stripes.shifted import Shifted


WIDTH, HEIGHT = 96, 64
SETTINGS = ReconstructSettings(chunk_records=3)


def _at(address: int, frames: np.ndarray) -> np.ndarray:
    """The same frames, their first byte `address` beyond a multiple of 64."""
    memory = np.zeros(frames.nbytes + 128, np.uint8)
    start = -memory.ctypes.data % 64 + address
    placed = memory[start : start + frames.nbytes].reshape(frames.shape)
    placed[:] = frames
    return placed


def _scene(records: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    light = 90.0 * np.exp(-0.5 * ((np.arange(WIDTH) - 45.3 - 0.05 * np.arange(HEIGHT)[:, None]) / 1.6) ** 2)
    off = 30.0 + 20.0 * rng.random((records, HEIGHT, WIDTH))
    return (off + light).round().astype(np.uint8), off.round().astype(np.uint8)


SLOW = pytest.mark.slow


@pytest.mark.parametrize("address", [1, pytest.param(16, marks=SLOW), pytest.param(63, marks=SLOW)])
def test_result_does_not_depend_on_where_frames_lie(small_scanner, address):
    on, off = _scene(7)
    scanner, phi, noise = small_scanner(), 0.01 * np.arange(7), NoiseModel()
    clouds = [
        reconstruct(Sweep(_at(place, on), _at(place, off), phi), scanner, noise=noise, settings=SETTINGS)
        for place in (0, address)
    ]
    assert clouds[0].valid.mean() > 0.9
    for name in ("xyz", "rgb", "intensity", "sigma_random", "normals", "valid"):
        np.testing.assert_array_equal(getattr(clouds[0], name), getattr(clouds[1], name), err_msg=name)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="only a CPU computes in the memory of the host")
def test_memory_is_lent_not_copied():
    frames = _at(16, np.random.default_rng(1).integers(0, 256, (6, 8, 16), np.uint8))
    lender = Lender()
    inner = frames[2:4]
    lent = lender.lend("on", inner)
    assert isinstance(lent, Shifted)
    assert np.shares_memory(lent.memory, frames)
    assert lent.memory.ctypes.data % 64 == 0
    np.testing.assert_array_equal(np.asarray(lent[jnp.asarray(1, jnp.int32)].array()), inner[1])
    assert (
        int(lent[jnp.asarray(1, jnp.int32)].pixel(jnp.asarray(3, jnp.int32), jnp.asarray(5, jnp.int32)))
        == inner[1, 3, 5]
    )
    # Nothing is around an array of its own, and every other column is not one piece of memory.
    for alone in (frames[:, :, ::2], frames[2:4].copy()[:1, :1, :3]):
        lent = lender.lend("on", alone)
        assert isinstance(lent, Shifted)
        assert not np.shares_memory(lent.memory, frames)
        np.testing.assert_array_equal(np.asarray(lent[jnp.asarray(0, jnp.int32)].array()), alone[0])
    aligned = _at(0, frames)
    assert lender.lend("off", aligned) is aligned
