"""The native search against the reference, number by number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.stripes.frames.formats import FrameFormat, LaserLine
from jaxscan.stripes.search.candidates import NARROW, WIDE, thresholds
from jaxscan.stripes.search.locate import locate
from jaxscan.stripes.search.native import NativeLocator
from jaxscan.stripes.search.planes import Planes
from jaxscan.stripes.search.search import prepare_search, whole_lines
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import NoiseModel, StripeSettings


LINES, SAMPLES = 96, 203
SATURATION = 254
LEVELS = np.linspace(0.0, 255.0, 256) ** 1.1
SETUP = ExtractionSetup((SAMPLES, LINES), FrameFormat(), LaserLine(), StripeSettings())
REFERENCE = jax.jit(locate, static_argnames=("pitch", "saturation"))


def _frames(kind, sensor):
    """Two pairs of frames with stripes of all kinds."""
    rng = np.random.default_rng(3)
    camera = sensor(seed=4)
    x = np.arange(SAMPLES)[None, None, :]
    ambient = 10.0 + 60.0 * (kind == "bright") * (1 + np.sin(x / 9.0))
    level = np.zeros((2, LINES, SAMPLES))
    if kind != "empty":
        for _ in range(4):
            centre = rng.uniform(-2, SAMPLES + 2, (2, LINES, 1))
            width = rng.uniform(0.5, 9.0, (2, LINES, 1))
            height = 10 ** rng.uniform(0.7, 3.0, (2, LINES, 1))
            level += height * np.exp(-0.5 * ((x - centre) / width) ** 2) * (rng.uniform(size=(2, LINES, 1)) < 0.6)
    if kind == "noise":
        return tuple(rng.integers(0, 256, (2, LINES, SAMPLES), dtype=np.uint8) for _ in range(2))
    return camera.expose(level + ambient), camera.expose(np.broadcast_to(ambient, level.shape))


@pytest.mark.parametrize("pitch", [1, 2])
@pytest.mark.parametrize("kind", ["stripes", "bright", "noise", "empty"])
@pytest.mark.parametrize("gated", [False, True])
def test_same_candidates(kind, pitch, gated, sensor):
    on, off = _frames(kind, sensor)
    rng = np.random.default_rng(5)
    low = rng.integers(0, SAMPLES // 2, LINES) if gated else np.zeros(LINES, np.int64)
    high = low + rng.integers(-5, SAMPLES, LINES) if gated else np.full(LINES, SAMPLES)
    ratio = np.array([128, 131 if gated else 128], np.float32) / 128
    search = prepare_search(SETUP, NoiseModel(), whole_lines(SETUP), has_off=True)._replace(
        low=low.astype(np.int32),
        high=np.minimum(high, SAMPLES).astype(np.int32),
        thresholds=thresholds(NoiseModel(), StripeSettings(), pitch=pitch, has_off=True),
        levels=LEVELS.astype(np.float32),
    )
    how = {"pitch": pitch, "saturation": SATURATION}
    with jax.enable_x64(False):
        reference = jax.tree.map(np.asarray, REFERENCE(Planes(jnp.asarray(on), jnp.asarray(off), ratio), search, **how))
    (expected,) = reference.lists
    exists = reference.slots.reshape(-1) >= 0
    if kind in ("stripes", "bright"):
        assert 0.2 < exists.mean() < 1.0
    native = NativeLocator().locate(Planes(on, off, ratio), search, **how)
    slots = native.slots.reshape(-1)
    np.testing.assert_array_equal(slots >= 0, exists)
    assert sum(int(found.total) for found in native.lists) == exists.sum()
    behind = 0
    for found, samples in zip(native.lists, (NARROW, WIDE), strict=True):
        place = np.flatnonzero((slots >= behind) & (slots < behind + found.start.size))
        index = slots[place] - behind
        behind += found.start.size
        np.testing.assert_array_equal(np.sort(index), np.arange(found.total))
        outer = (WIDE - samples) // 2
        for name in ("frame", "extent", "bins", "saturated"):
            values = getattr(found, name).reshape(-1)[index]
            np.testing.assert_array_equal(values, getattr(expected, name)[0, place], err_msg=name)
        for name in ("start", "middle"):
            values = getattr(found, name).reshape(-1)[index]
            np.testing.assert_allclose(values, getattr(expected, name)[0, place], atol=1e-4, err_msg=name)
        for name in ("on", "off"):
            values = np.moveaxis(getattr(found, name), 1, 0).reshape(samples, -1)[:, index]
            whole = getattr(expected, name)[0][:, place]
            np.testing.assert_array_equal(values, whole[outer : WIDE - outer], err_msg=name)
            if name == "on":
                # A narrow window leaves out nothing that counts.
                assert np.all(whole[:outer] == -1.0) and np.all(whole[WIDE - outer :] == -1.0)
