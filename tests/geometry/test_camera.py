"""Each camera model inherits `CameraContract`; the pinhole is checked against OpenCV besides."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.geometry import Pinhole


def pinhole(distortion, skew=0.0):
    fields = map(np.float64, (812.0, 805.0, 651.3, 498.8))
    return Pinhole(*fields, np.asarray(distortion, np.float64), 1280, 1024, np.float64(skew))


LENSES = {
    "none": [0, 0, 0, 0, 0],
    "paper": [-0.1, 0, 0, 0, 0],
    "barrel": [-0.28, 0.09, 0.001, -0.0007, -0.01],
    "pincushion": [0.12, 0.03, -0.0004, 0.0006, 0.004],
    "rational": [0.9, 0.3, 0.0003, -0.0002, 0.05, 1.2, 0.5, 0.09],
}
project = jax.jit(lambda camera, p: jax.vmap(camera.project)(p))
unproject = jax.jit(lambda camera, q: jax.vmap(camera.unproject)(q))
moved_ray = jax.jit(lambda camera, step, q: camera.retract(step).unproject(q))
moved_ray_jacobian = jax.jit(jax.jacfwd(lambda step, camera, q: camera.retract(step).unproject(q)))
ray_forward = jax.jit(lambda camera, q: jax.jacfwd(camera.unproject)(q))
ray_reverse = jax.jit(lambda camera, q: jax.jacrev(camera.unproject)(q))


def image_grid(camera, count=41):
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, count), np.linspace(-0.5, camera.height - 0.5, count))
    return np.stack([u.ravel(), v.ravel()], -1)


class CameraContract:
    """What every camera model must do. A subclass gives `camera` as a parametrised fixture."""

    def test_round_trip_over_the_whole_image(self, camera):
        q = image_grid(camera)
        ray = unproject(camera, q)
        # The design's bound in float64.
        np.testing.assert_allclose(project(camera, ray), q, atol=1e-10 * camera.width / 100, rtol=0)
        np.testing.assert_allclose(np.linalg.norm(ray, axis=1), 1.0, atol=1e-14)

    def test_round_trip_in_single_precision(self, camera):
        single = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), camera)
        q = image_grid(camera).astype(np.float32)
        ray = unproject(single, jnp.asarray(q))
        assert ray.dtype == jnp.float32
        # The design's bound in float32, seen through exact projection of the rounded ray.
        np.testing.assert_allclose(project(camera, np.asarray(ray, np.float64)), q, atol=1e-3, rtol=0)

    def test_length_of_the_point_does_not_matter(self, camera):
        ray = unproject(camera, image_grid(camera, 5))
        np.testing.assert_allclose(project(camera, 7.5 * ray), project(camera, ray), atol=1e-9, rtol=0)

    def test_derivative_of_the_ray_is_that_of_the_projection_inverted(self, camera):
        q = jnp.array([100.0, 900.0])
        ray = camera.unproject(q)
        chain = jax.jacfwd(camera.project)(ray) @ ray_forward(camera, q)
        np.testing.assert_allclose(chain, np.eye(2), atol=1e-9)
        np.testing.assert_allclose(ray_reverse(camera, q), ray_forward(camera, q), atol=1e-13)

    def test_derivative_of_the_ray_by_the_parameters(self, camera):
        q = jnp.array([1200.0, 60.0])
        zero = jnp.zeros(len(camera.parameter_names()))
        jacobian = moved_ray_jacobian(zero, camera, q)
        for i in range(len(zero)):
            h = 1e-4 if i < 4 else 1e-6
            numeric = (moved_ray(camera, zero.at[i].set(h), q) - moved_ray(camera, zero.at[i].set(-h), q)) / (2 * h)
            # Central differences: error of order h^2 f''' and 1e-16 / h.
            np.testing.assert_allclose(jacobian[:, i], numeric, atol=2e-9)

    def test_finite_outside_its_domain(self, camera):
        for p in ([0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.3, -0.2, -1.0]):
            assert np.isfinite(camera.project(jnp.array(p))).all()
            assert np.isfinite(jax.jacfwd(camera.project)(jnp.array(p))).all()
        assert np.isfinite(camera.unproject(jnp.array([-4000.0, 9000.0]))).all()

    def test_retract_by_zero_is_identity(self, camera):
        moved = camera.retract(jnp.zeros(len(camera.parameter_names())))
        for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(camera), strict=True):
            np.testing.assert_array_equal(a, b)


class TestPinhole(CameraContract):
    @pytest.fixture(params=LENSES)
    def camera(self, request):
        return pinhole(LENSES[request.param])

    def test_equals_opencv(self, camera):
        p = np.random.default_rng(0).normal(size=(200, 3)) * [0.6, 0.5, 0.3] + [0, 0, 2.0]
        k = np.asarray(camera.matrix())
        expected = cv2.projectPoints(p, np.zeros(3), np.zeros(3), k, camera.distortion)[0].reshape(-1, 2)
        np.testing.assert_allclose(project(camera, p), expected, atol=1e-9, rtol=0)

    def test_unproject_equals_opencv_run_to_convergence(self, camera):
        q = image_grid(camera, 9)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 300, 1e-14)
        k = np.asarray(camera.matrix())
        if hasattr(cv2, "undistortPointsIter"):
            expected = cv2.undistortPointsIter(q.reshape(-1, 1, 2), k, camera.distortion, None, None, criteria)
        else:
            expected = cv2.undistortPoints(q.reshape(-1, 1, 2), k, camera.distortion, criteria=criteria)
        ray = np.asarray(unproject(camera, q))
        np.testing.assert_allclose(ray[:, :2] / ray[:, 2:], expected.reshape(-1, 2), atol=1e-9, rtol=0)


def test_the_papers_lens_is_a_special_case():
    # Equation (3): u' = u + (u - u0) k r^2 with r in normalised coordinates.
    camera, p = pinhole([0.07, 0, 0, 0, 0]), np.array([0.4, -0.3, 1.6])
    x = p[:2] / p[2]
    undistorted = np.array([camera.fx * x[0] + camera.cx, camera.fy * x[1] + camera.cy])
    centre = np.array([camera.cx, camera.cy])
    expected = undistorted + (undistorted - centre) * 0.07 * (x @ x)
    np.testing.assert_allclose(camera.project(jnp.array(p)), expected, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.floats(-3, 3), st.floats(0, 1279), st.floats(0, 1023))
def test_skew_round_trip(skew, u, v):
    camera = pinhole(LENSES["barrel"], skew)
    q = jnp.array([[u, v]])
    np.testing.assert_allclose(project(camera, unproject(camera, q)), q, atol=1e-9, rtol=0)


def test_skew_is_the_papers_gamma():
    camera, p = pinhole(LENSES["none"], 2.5), jnp.array([0.4, -0.3, 1.6])
    s = camera.matrix() @ p
    np.testing.assert_allclose(camera.project(p), s[:2] / s[2], atol=1e-12)


def test_wrong_number_of_coefficients_is_named():
    with pytest.raises(ValueError, match="5 or 8"):
        pinhole([0.1, 0.2])
