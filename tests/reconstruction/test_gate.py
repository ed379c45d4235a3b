"""The gate holds every centre that triangulates, and little else."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.geometry import Fisheye, LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction.gate import line_gate
from jaxscan.reconstruction.points import Limits, triangulate
from jaxscan.reconstruction.settings import ReconstructSettings


WIDTH, HEIGHT = 320, 240
TURNTABLE = Turntable.from_axis([0.02, -1.0, 0.01], [0.01, 0.0, -0.15])


def pinhole(k1=-0.25):
    focal = [np.float64(f) for f in (300.0, 302.0, 163.0, 118.0)]
    return Pinhole(*focal, np.array([k1, 0.08, 1e-3, -5e-4, 0.0]), width=WIDTH, height=HEIGHT)


def fisheye(focal=110.0):
    numbers = [np.float64(f) for f in (focal, focal, 161.0, 118.0)]
    return Fisheye(*numbers, np.array([-0.02, 0.003, 0.0, 0.0]), width=WIDTH, height=HEIGHT)


def rig(camera, normal, distance, bow=(0.0, 0.0)):
    flat = LaserSheet.from_plane(np.array(normal), distance)
    sheet = LaserSheet(flat.normal, flat.distance, np.array(bow, np.float64), flat.basis)
    other = LaserSheet.from_plane(np.array([0.1, 1.0, 0.4]), 0.3)
    return Scanner(camera, stack_lasers([other, sheet]), TURNTABLE, laser_names=("other", "one"))


@functools.partial(jax.jit, static_argnames="axis")
def everywhere(rig, u, line, axis):
    unlimited = Limits(*(jnp.asarray(limit, u.dtype) for limit in (0.0, math.inf, ReconstructSettings().min_incidence)))
    return triangulate(rig, u, line, 1, stripe_axis=axis, limits=unlimited)


def triangulated(scanner, u, line, axis, near, far):
    """What `triangulate` accepts with these limits, and its range [m]; compiled once for all limits."""
    found = everywhere(scanner.rig, jnp.asarray(u), jnp.asarray(line), axis)
    range_m = np.asarray(found.range_m)
    return np.asarray(found.valid) & (range_m >= near) & (range_m <= far), range_m


def size_of(axis):
    return (HEIGHT, WIDTH) if axis == "rows" else (WIDTH, HEIGHT)


cameras = st.one_of(st.builds(pinhole, st.floats(-0.3, 0.1)), st.builds(fisheye, st.floats(70.0, 200.0)))
directions = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
    lambda n: math.hypot(*n) > 0.2 and math.hypot(*n[:2]) > 0.02
)


@settings(max_examples=60, deadline=None)
@given(
    camera=cameras,
    normal=directions,
    distance=st.floats(0.02, 2.0),
    bow=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    axis=st.sampled_from(["rows", "columns"]),
    near=st.floats(0.0, 3.0),
    depth=st.floats(0.002, 30.0),
    seed=st.integers(0, 1000),
)
def test_nothing_that_triangulates_is_outside(camera, normal, distance, bow, axis, near, depth, seed):
    scanner = rig(camera, normal, distance, bow)
    gate = line_gate(scanner, 1, stripe_axis=axis, min_range_m=near, max_range_m=near + depth, margin_px=0.0)
    lines, length = size_of(axis)
    rng = np.random.default_rng(seed)
    line = rng.integers(0, lines, 4000)
    u = rng.uniform(-0.5, length - 0.5, 4000)
    valid, _ = triangulated(scanner, u, line.astype(float), axis, near, near + depth)
    inside = (u >= gate.low[line] - 0.5) & (u <= gate.high[line] - 0.5)
    assert not np.any(valid & ~inside)
    assert np.all((gate.low >= 0) & (gate.high <= length) & (gate.low <= gate.high))


@pytest.mark.parametrize("axis", ["rows", "columns"])
@pytest.mark.parametrize("camera", [pinhole(), fisheye()], ids=["pinhole", "fisheye"])
def test_the_gate_is_tight(camera, axis):
    normal = [-1.0, -0.03, 0.3] if axis == "rows" else [0.02, 1.0, 0.3]
    scanner = rig(camera, normal, 0.2, (0.01, 0.003))
    near, far = 0.8, 5.0
    gate = line_gate(scanner, 1, stripe_axis=axis, min_range_m=near, max_range_m=far, margin_px=0.0)
    lines, length = size_of(axis)
    line, u = np.meshgrid(np.arange(float(lines)), np.arange(float(length)), indexing="ij")
    valid, _ = triangulated(scanner, u.ravel(), line.ravel(), axis, near, far)
    valid = valid.reshape(lines, length)
    some = valid.any(1)
    assert some.any()
    first, last = valid.argmax(1), length - 1 - valid[:, ::-1].argmax(1)
    # The pixels beside the true ends, and one more that the interpolation cannot exclude.
    assert np.all((first - gate.low)[some] <= 2) and np.all((gate.high - 1 - last)[some] <= 2)
    assert np.all((first - gate.low)[some] >= 0) and np.all((gate.high - 1 - last)[some] >= 0)


def test_a_margin_reaches_further_but_not_out_of_the_image():
    scanner = rig(pinhole(), [-1.0, -0.03, 0.3], 0.2)
    tight = line_gate(scanner, 1, min_range_m=0.8, max_range_m=2.0, margin_px=0.0)
    wide = line_gate(scanner, 1, min_range_m=0.8, max_range_m=2.0, margin_px=4.5)
    some = tight.high > 0
    np.testing.assert_array_equal(wide.low[some], np.maximum(tight.low[some] - 5, 0))
    np.testing.assert_array_equal(wide.high[some], np.minimum(tight.high[some] + 5, WIDTH))


def test_nothing_fits():
    # The sheet is behind the camera over the whole image.
    gate = line_gate(rig(pinhole(), [0.05, 0.0, -1.0], 0.5), 1)
    np.testing.assert_array_equal(gate.low, 0)
    np.testing.assert_array_equal(gate.high, 0)
    assert gate.low.dtype == np.int32 and gate.low.shape == (HEIGHT,)


def test_everything_fits_without_limits():
    gate = line_gate(rig(pinhole(), [0.0, 0.05, 1.0], 1.0), 1, min_range_m=0.0, max_range_m=math.inf)
    np.testing.assert_array_equal(gate.low, 0)
    np.testing.assert_array_equal(gate.high, WIDTH)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_near_side(axis, sign):
    normal = [sign, 0.03, 0.3] if axis == "rows" else [0.03, sign, 0.3]
    scanner = rig(pinhole(), normal, 0.2)
    gate = line_gate(scanner, 1, stripe_axis=axis)
    lines, _ = size_of(axis)
    middle = lines // 2
    u = np.array([gate.low[middle] + 4.0, gate.high[middle] - 4.0])
    _, range_m = triangulated(scanner, u, np.full(2, float(middle)), axis, 0.0, 1e3)
    assert gate.near_side == (1 if range_m[1] < range_m[0] else -1)


def test_single_precision_gives_the_same():
    scanner = rig(pinhole(), [-1.0, -0.03, 0.3], 0.25)
    single = jax.tree.map(lambda leaf: leaf.astype(np.float32), scanner)
    before, after = (line_gate(s, 1, min_range_m=0.8, max_range_m=2.0) for s in (scanner, single))
    assert np.max(np.abs(before.low - after.low)) <= 1 and np.max(np.abs(before.high - after.high)) <= 1


def test_limits_that_contradict_each_other():
    scanner = rig(pinhole(), [-1.0, -0.03, 0.3], 0.2)
    with pytest.raises(ValueError, match="min_range_m"):
        line_gate(scanner, 1, min_range_m=2.0, max_range_m=1.0)
    with pytest.raises(ValueError, match="margin"):
        line_gate(scanner, 1, margin_px=-1.0)
