"""Each camera model inherits `CameraContract`, and is checked against OpenCV or its published formulas besides."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.geometry import CAMERAS, DoubleSphere, Fisheye, Pinhole
from jaxscan.geometry.cameras import CENTRE, FOCAL
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.motions import MOTION_BLOCKS


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


def fisheye(focal, distortion, skew=0.0):
    fields = map(np.float64, (focal, 0.997 * focal, 651.3, 498.8))
    return Fisheye(*fields, np.asarray(distortion, np.float64), 1280, 1024, np.float64(skew))


FISHEYES = {
    # 149 degrees at the farthest corner of the image, 102, 100 and 122.
    "equidistant": (320.0, [0, 0, 0, 0]),
    "barrel": (447.0, [-0.03, 0.004, -0.001, 0.0001]),
    "stereographic": (367.0, [0.0833, 0.0083, 0.0008, 0.0001]),
    "equisolid": (480.0, [-0.0417, 0.0005, 0.0, 0.0]),
}


def double_sphere(focal, xi, alpha):
    return DoubleSphere(focal, 0.997 * focal, 651.3, 498.8, np.array([xi, alpha]), 1280, 1024)


DOUBLE_SPHERES = {
    # 108 degrees at the farthest corner of the image, 81, 85 and 105.
    "published": (320.0, -0.2, 0.55),
    "mild": (450.0, 0.05, 0.4),
    "unified": (420.0, 0.0, 0.5),
    "far": (600.0, 0.6, 0.6),
}
project = jax.jit(lambda camera, p: jax.vmap(camera.project)(p))
unproject = jax.jit(lambda camera, q: jax.vmap(camera.unproject)(q))
moved_ray = jax.jit(lambda camera, step, q: camera.retract(step).unproject(q))
moved_ray_jacobian = jax.jit(jax.jacfwd(lambda step, camera, q: camera.retract(step).unproject(q)))
ray_forward = jax.jit(lambda camera, q: with_jacobian(camera.unproject, q))
point_forward = jax.jit(lambda camera, p: with_jacobian(camera.project, p))
ray_reverse = jax.jit(lambda camera, q: jax.jacrev(camera.unproject)(q))


def with_jacobian(function, x):
    return function(x), jax.jacfwd(function)(x)


def image_grid(camera, count=41):
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, count), np.linspace(-0.5, camera.height - 0.5, count))
    return np.stack([u.ravel(), v.ravel()], -1)


class CameraContract:
    """What every camera model must do. A subclass gives its `model`, and `camera` as a parametrised fixture."""

    def magnification(self, camera):
        """Focal lengths per slope that one pixel is worth on the optical axis."""
        return 1.0

    def test_is_registered_and_its_parameters_are_described(self, camera):
        assert CAMERAS[camera.model] is type(camera)
        blocks = camera.blocks()
        assert blocks[:3] == (*FOCAL, *CENTRE)
        names = [name for block in blocks for name in block.parameters]
        assert len(set(names)) == len(names) and camera.parameter_names() == tuple(names[: len(camera.parameters())])
        assert all(block.scale > 0 and block.sigma > 0 for block in blocks)
        # A prior that nothing can switch off would be a secret; optional coefficients are cut off at the end.
        assert all(bool(block.prior) == np.isfinite(block.sigma) for block in blocks)
        assert [block.optional for block in blocks] == sorted(block.optional for block in blocks)

    def test_first_lens_follows_a_curve(self, camera):
        theta = np.linspace(0.02, 1.6 if camera.wide else 0.6, 60)
        # Exactly what the seed assumes where nothing better is known.
        radius = 300.0 * (theta * (1.0 - 0.02 * theta**2) if camera.wide else np.tan(theta))
        ray = np.stack([np.sin(theta), np.zeros(60), np.cos(theta)], -1)
        for focal, *lens in camera.fit_curve(theta, radius):
            first = type(camera)(focal, focal, 0.0, 0.0, np.array(lens), 1280, 1024)
            # A few pixels of 450 are far inside the range from which the solve converges.
            np.testing.assert_allclose(project(first, ray)[:, 0], radius, atol=5.0)

    def test_round_trip_over_the_whole_image(self, camera):
        q = image_grid(camera)
        ray = unproject(camera, q)
        # The design's bound in float64.
        np.testing.assert_allclose(project(camera, ray), q, atol=1e-10, rtol=0)
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
        ray, by_pixel = ray_forward(camera, q)
        chain = point_forward(camera, ray)[1] @ by_pixel
        np.testing.assert_allclose(chain, np.eye(2), atol=1e-9)
        np.testing.assert_allclose(ray_reverse(camera, q), by_pixel, atol=1e-13)

    def test_derivative_of_the_ray_by_the_parameters(self, camera):
        q = jnp.array([1200.0, 60.0])
        zero = jnp.zeros(len(camera.parameter_names()))
        jacobian = moved_ray_jacobian(zero, camera, q)
        for i in range(len(zero)):
            size = float(jnp.abs(jacobian[:, i]).max())
            h = 1e-5 / size
            numeric = (moved_ray(camera, zero.at[i].set(h), q) - moved_ray(camera, zero.at[i].set(-h), q)) / (2 * h)
            # The ray moves by 1e-5: central differences leave its square, and rounding 1e-11.
            np.testing.assert_allclose(jacobian[:, i], numeric, atol=2e-9 * size)

    def test_finite_outside_its_domain(self, camera):
        for p in ([0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.3, -0.2, -1.0], [0.0, 0.0, -1.0]):
            for value in point_forward(camera, jnp.array(p)):
                assert np.isfinite(value).all()
        for value in ray_forward(camera, jnp.array([-4000.0, 9000.0])):
            assert np.isfinite(value).all()

    def test_smooth_at_the_optical_axis(self, camera):
        centre = np.array([camera.cx, camera.cy])
        scale = np.diag([camera.fx, camera.fy]) * self.magnification(camera)
        # Over slopes of 5e-4 these lenses bend the image by 5e-6 of them at most; float32 has 6e-5 px there.
        for dtype, pixel in ((np.float64, 2e-6), (np.float32, 2e-4)):
            same = jax.tree.map(lambda leaf, dtype=dtype: jnp.asarray(leaf, dtype), camera)
            for slope in ([0.0, 0.0], [1e-12, 0.0], [3e-7, -2e-7], [3e-4, 5e-4]):
                p = jnp.array([*slope, 1.0], dtype)
                q, by_point = map(np.asarray, point_forward(same, p))
                np.testing.assert_allclose(q, centre + scale @ slope, atol=pixel)
                np.testing.assert_allclose(np.linalg.solve(scale, by_point[:, :2]), np.eye(2), atol=1e-5)
                ray, by_pixel = map(np.asarray, ray_forward(same, q))
                np.testing.assert_allclose(ray, p, atol=1e-6)
                np.testing.assert_allclose(by_pixel[:2] @ scale, np.eye(2), atol=1e-5)

    def test_retract_by_zero_is_identity(self, camera):
        moved = camera.retract(jnp.zeros(len(camera.parameter_names())))
        for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(camera), strict=True):
            np.testing.assert_array_equal(a, b)

    def test_parameters_are_what_retract_moves(self, camera):
        step = 1e-3 * jnp.arange(1.0, 1 + len(camera.parameter_names()))
        np.testing.assert_allclose(camera.retract(step).parameters() - camera.parameters(), step, atol=1e-12)


class TestPinhole(CameraContract):
    model = Pinhole

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


def radius_angle(camera, theta):
    """theta_d, written out."""
    k1, k2, k3, k4 = camera.distortion
    return theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9


class TestFisheye(CameraContract):
    model = Fisheye

    @pytest.fixture(params=FISHEYES)
    def camera(self, request):
        return fisheye(*FISHEYES[request.param])

    def test_equals_opencv(self, camera):
        rng = np.random.default_rng(0)
        p = rng.normal(size=(300, 3)) * [1.0, 1.0, 0.5]
        p[:, 2] = 0.02 + np.abs(p[:, 2])
        k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        expected = cv2.fisheye.projectPoints(p[None], np.zeros((1, 3)), np.zeros((1, 3)), k, camera.distortion)[0]
        q = np.asarray(project(camera, p))
        np.testing.assert_allclose(q, expected.reshape(-1, 2), atol=1e-9, rtol=0)
        # OpenCV inverts up to theta_d = 90 degrees, and gives the slopes x / z, which lose digits there.
        theta = np.arctan2(np.hypot(p[:, 0], p[:, 1]), p[:, 2])
        near = (theta < np.radians(80)) & (radius_angle(camera, theta) < np.radians(85))
        assert near.sum() > 150
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
        slopes = cv2.fisheye.undistortPoints(q[near][None], k, camera.distortion, criteria=criteria).reshape(-1, 2)
        ray = np.asarray(unproject(camera, q[near]))
        np.testing.assert_allclose(ray[:, :2] / ray[:, 2:], slopes, atol=1e-9, rtol=0)

    def test_plain_formula_beyond_the_camera_plane(self, camera):
        theta, psi = (x.ravel() for x in np.meshgrid(np.radians(np.linspace(0.5, 100, 200)), np.linspace(0, 6.2, 7)))
        ray = np.stack([np.sin(theta) * np.cos(psi), np.sin(theta) * np.sin(psi), np.cos(theta)], -1)
        assert (ray[:, 2] < -0.17).any()
        radius = radius_angle(camera, theta)
        q = np.stack([camera.fx * radius * np.cos(psi) + camera.cx, camera.fy * radius * np.sin(psi) + camera.cy], -1)
        np.testing.assert_allclose(project(camera, 2.0 * ray), q, atol=1e-10, rtol=0)
        np.testing.assert_allclose(unproject(camera, q), ray, atol=1e-12, rtol=0)


def plain_double_sphere(camera, p):
    """Equations (40)-(42) of the paper, written out."""
    xi, alpha = camera.distortion
    d1 = np.sqrt((p**2).sum(-1))
    d2 = np.sqrt(p[..., 0] ** 2 + p[..., 1] ** 2 + (xi * d1 + p[..., 2]) ** 2)
    scale = alpha * d2 + (1 - alpha) * (xi * d1 + p[..., 2])
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return focal * p[..., :2] / scale[..., None] + centre


class TestDoubleSphere(CameraContract):
    model = DoubleSphere

    @pytest.fixture(params=DOUBLE_SPHERES)
    def camera(self, request):
        return double_sphere(*DOUBLE_SPHERES[request.param])

    def magnification(self, camera):
        return 1.0 / (1.0 + float(camera.distortion[0]))

    def test_plain_formula_up_to_the_largest_angle(self, camera):
        xi, alpha = camera.distortion
        # Equations (43)-(45): seen is what has z > -w2 d1.
        w1 = min(alpha, 1 - alpha) / max(alpha, 1 - alpha)
        last = np.arccos(-(w1 + xi) / np.sqrt(2 * w1 * xi + xi**2 + 1))
        theta, psi = (x.ravel() for x in np.meshgrid(np.linspace(0.01, 0.98 * last, 150), np.linspace(0, 6.2, 7)))
        assert last > np.radians(90)
        ray = np.stack([np.sin(theta) * np.cos(psi), np.sin(theta) * np.sin(psi), np.cos(theta)], -1)
        q = plain_double_sphere(camera, ray)
        np.testing.assert_allclose(project(camera, 2.0 * ray), q, atol=1e-9, rtol=0)
        # Beside the largest angle a pixel's rounding grows to some hundred times its size.
        np.testing.assert_allclose(unproject(camera, q), ray, atol=1e-11, rtol=0)


@pytest.mark.parametrize("lens", ["published", "far"])
def test_pixels_that_no_ray_reaches_look_at_the_largest_angle(lens):
    camera = double_sphere(*DOUBLE_SPHERES[lens])
    xi, alpha = camera.distortion
    w1 = (1 - alpha) / alpha
    # Seen from the second sphere's centre at the angle b, the radius is sin b / (alpha + (1 - alpha) cos b),
    # largest at cos b = -w1; this is where (xi + z)^2 = w1^2 (1 + 2 xi z + xi^2). The paper's bound lies a
    # little inside.
    limit = -xi * (1 - w1**2) - w1 * np.sqrt(1 - xi**2 + xi**2 * w1**2)
    radius = np.array([1.0001, 3.0, 40.0]) / np.sqrt(2 * alpha - 1)
    ray = np.asarray(unproject(camera, np.stack([camera.cx + camera.fx * radius, np.full(3, camera.cy)], -1)))
    np.testing.assert_allclose(ray[:, 2], limit, atol=1e-12)


def test_a_double_sphere_by_hand():
    camera = DoubleSphere(100.0, 200.0, 10.0, 20.0, np.array([0.5, 0.25]), 640, 480)
    # d1 = 3; z = 1.5 + 2; d2 = sqrt(1 + 4 + 12.25); D = d2 / 4 + 3/4 of 3.5.
    scale = np.sqrt(17.25) / 4 + 2.625
    np.testing.assert_allclose(
        camera.project(jnp.array([1.0, 2.0, 2.0])), [10 + 100 / scale, 20 + 400 / scale], atol=1e-12
    )


def test_special_cases_of_the_double_sphere():
    p = np.random.default_rng(1).normal(size=(200, 3)) * [0.6, 0.5, 0.3] + [0, 0, 2.0]
    straight, flat = double_sphere(400.0, 0.0, 0.0), pinhole([0, 0, 0, 0, 0])
    flat = flat.retract(jnp.pad(straight.parameters()[:4], (0, 5)) - flat.parameters())
    np.testing.assert_allclose(project(straight, p), project(flat, p), atol=1e-11, rtol=0)
    # xi = 0 is the unified model, the enhanced one with beta = 1: d = alpha |p| + (1 - alpha) z.
    unified = double_sphere(400.0, 0.0, 0.6)
    scale = 0.6 * np.linalg.norm(p, axis=1) + 0.4 * p[:, 2]
    expected = np.array([unified.fx, unified.fy]) * p[:, :2] / scale[:, None] + [unified.cx, unified.cy]
    np.testing.assert_allclose(project(unified, p), expected, atol=1e-11, rtol=0)


def test_a_fisheye_that_folds_over_ends_at_its_largest_angle():
    camera = fisheye(300.0, [-0.15, 0.0, 0.0, 0.0])
    # theta - 0.15 theta^3 grows up to theta = 1 / sqrt(0.45) = 85.4 degrees, where it is 0.994.
    fold = 1 / np.sqrt(0.45)
    radius = np.array([0.2, 0.9, 0.98, 0.993, 1.0, 3.0, 40.0])
    ray = np.asarray(unproject(camera, np.stack([camera.cx + camera.fx * radius, np.full(7, camera.cy)], -1)))
    theta = np.arctan2(ray[:, 0], ray[:, 2])
    np.testing.assert_allclose(radius_angle(camera, theta[:4]), radius[:4], atol=1e-12)
    assert (np.diff(theta[:4]) > 0).all() and theta[3] < fold
    # The fold is found on a grid: linearly between its points, to 1e-3.
    np.testing.assert_allclose(theta[4:], fold, atol=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.floats(0, 0.99))
def test_any_fisheye_is_inverted_up_to_its_fold(shape, share):
    camera = fisheye(300.0, np.array(shape) * [0.3, 0.1, 0.03, 0.01])
    theta = np.linspace(0, np.pi, 20001)
    k1, k2, k3, k4 = camera.distortion
    falling = 1 + 3 * k1 * theta**2 + 5 * k2 * theta**4 + 7 * k3 * theta**6 + 9 * k4 * theta**8 <= 0
    last = theta[np.argmax(falling)] if falling.any() else np.pi
    # Up to 0.9 of the fold the inverse is well determined: its slope there is above 0.1.
    angle = 0.9 * share * last
    q = np.array([[camera.cx + camera.fx * radius_angle(camera, angle), camera.cy]])
    ray = np.asarray(unproject(camera, q))[0]
    np.testing.assert_allclose(np.arctan2(ray[0], ray[2]), angle, atol=1e-8)


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


def test_skew_of_a_fisheye_is_opencvs_alpha():
    camera = fisheye(*FISHEYES["barrel"], 1.7)
    p = np.random.default_rng(0).normal(size=(300, 3)) * [1.0, 1.0, 0.5]
    p[:, 2] = 0.02 + np.abs(p[:, 2])
    k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    still, alpha = np.zeros((1, 3)), float(camera.skew / camera.fx)
    expected = cv2.fisheye.projectPoints(p[None], still, still, k, camera.distortion, alpha=alpha)[0]
    q = np.asarray(project(camera, p))
    np.testing.assert_allclose(q, expected.reshape(-1, 2), atol=1e-9, rtol=0)
    rays = p / np.linalg.norm(p, axis=1, keepdims=True)
    np.testing.assert_allclose(unproject(camera, q), rays, atol=1e-12, rtol=0)
    slopes = jax.vmap(jax.jacfwd(camera.project))(jnp.array(p))
    np.testing.assert_allclose(camera.slopes(p), slopes, atol=1e-9, rtol=1e-12)


def test_wrong_number_of_coefficients_is_named():
    with pytest.raises(ValueError, match="5 or 8"):
        pinhole([0.1, 0.2])
    with pytest.raises(ValueError, match="4 coefficients"):
        fisheye(300.0, [0.1, 0.2])
    with pytest.raises(ValueError, match="2 coefficients"):
        DoubleSphere(300.0, 300.0, 0.0, 0.0, np.zeros(3), 640, 480)


def test_every_registered_model_has_a_contract():
    assert {contract.model for contract in CameraContract.__subclasses__()} == set(CAMERAS.values())


def test_blocks_and_priors_of_one_name_mean_the_same_everywhere():
    of_rig = {block.name for block in (*LASER_BLOCKS, *MOTION_BLOCKS)}
    sigmas = {}
    for block in (block for camera in CAMERAS.values() for block in camera.blocks()):
        assert block.name not in of_rig
        assert sigmas.setdefault(block.prior, block.sigma) == block.sigma
