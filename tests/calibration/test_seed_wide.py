"""First values of a fisheye from boards all around it, by a forward model in plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration.first_values import seed_camera
from jaxscan.calibration.problem import prepare
from jaxscan.calibration.sheets import lift_stripes
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Fisheye


pytestmark = pytest.mark.more


LENSES = {
    "equidistant": (0.0, 0.0, 0.0, 0.0),
    "equisolid": (-1 / 24, 1 / 1920, -1 / 322560, 0.0),
    "stereographic": (1 / 12, 1 / 120, 17 / 20160, 31 / 362880),
    "kannala": (-0.03, 0.004, -0.001, 1e-4),
}


def rig_of(world, lens, fov_deg):
    """A lens that sees this field of view over the height of the image."""
    t = np.radians(fov_deg / 2)
    focal = 505.0 / (t + lens[0] * t**3 + lens[1] * t**5 + lens[2] * t**7 + lens[3] * t**9)
    return world.Rig(focal=(focal, 1.001 * focal), centre=(650.0, 503.0), lens=lens)


def seen(world, rig, seed=0):
    return world.with_noise(world.observe(rig, free=14, placements=0, seed=seed), seed)


@pytest.mark.parametrize(
    ("lens", "fov_deg"),
    [
        ("stereographic", 140),
        ("equisolid", 200),
        pytest.param("equidistant", 120, marks=pytest.mark.slow),
        pytest.param("equisolid", 160, marks=pytest.mark.slow),
        pytest.param("kannala", 200, marks=pytest.mark.slow),
    ],
)
def test_lens_and_poses_are_near(world, lens, fov_deg):
    rig = rig_of(world, LENSES[lens], fov_deg)
    observed = seen(world, rig)
    data = prepare(observed)
    (camera,), poses = seed_camera(data, "fisheye")
    # A lens of one coefficient with its centre 10 px off stands for one of four: the focal length
    # and the distances come out to a tenth, far inside what the solve converges from.
    assert camera.fx == camera.fy == pytest.approx(rig.focal[0], rel=0.1)
    views = np.flatnonzero(data.fixes_pose)
    # The corner in the middle (9 x 7), by the true lens where the seed puts it. Lens and centre are
    # off by 10 px and more, so it must be within a square or two of where it was seen.
    middle = np.array([world.project(rig, pose[:3] @ np.append(data.board[31], 1.0)) for pose in poses[views]])
    assert np.abs(middle - observed.corners.q[:, 31]).max() < 30
    assert (np.einsum("vi,vi->v", poses[views, :3, 2], poses[views, :3, 3]) > 0).all()


def test_a_few_wrong_corners_do_no_harm(world):
    rig = rig_of(world, LENSES["kannala"], 200)
    observed = seen(world, rig)
    random = np.random.default_rng(5)
    q = observed.corners.q.copy()
    wrong = random.random(q.shape[:2]) < 0.03
    q[wrong] = random.uniform(0, 1000, (wrong.sum(), 2))
    (right,), _ = seed_camera(prepare(observed), "fisheye")
    (robust,), _ = seed_camera(prepare(replace(observed, corners=replace(observed.corners, q=q))), "fisheye")
    assert robust.fx == pytest.approx(float(right.fx), rel=0.05)


def test_stripes_beside_and_behind_the_camera_are_lifted(world):
    rig = rig_of(world, LENSES["kannala"], 200)
    camera = Fisheye(*rig.focal, *rig.centre, np.array(rig.lens), *rig.size)
    # A line 0.8 m from the camera that passes its plane, on a board that faces the camera.
    along, towards = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0), np.array([0.0, 1.0, 0.0])
    line = 0.8 * towards + np.linspace(-0.12, 0.05, 20)[:, None] * along
    pose = np.eye(4)
    pose[:3] = np.column_stack([along, np.cross(towards, along), towards, 0.8 * towards])
    valid = np.arange(20) != 3
    data = prepare(world.observe(rig, free=3, placements=0))._replace(
        stripe_q=world.project(rig, line)[None],
        stripe_valid=valid[None],
        stripe_view=np.zeros(1, np.int32),
        stripe_laser=np.zeros(1, np.int32),
    )
    assert (line[:, 2] < 0).any() and (line[:, 2] > 0).any()
    lifted = lift_stripes(data, camera, pose[None])
    np.testing.assert_allclose(lifted.points[0][lifted.valid[0]], line[valid], atol=1e-12)


def test_degenerate_sets_are_refused(world):
    rig = rig_of(world, LENSES["equidistant"], 160)
    data = prepare(seen(world, rig))
    with pytest.raises(CalibrationError, match="not found in any view"):
        seed_camera(data._replace(fixes_pose=np.zeros_like(data.fixes_pose)), "fisheye")
    with pytest.raises(CalibrationError, match=r"2 view\(s\) and a camera needs at least 3"):
        seed_camera(data._replace(fixes_pose=np.arange(len(data.fixes_pose)) < 2), "fisheye")
    random = np.random.default_rng(2)
    board = rig.board.corners() - rig.board.corners().mean(0)
    places = [np.array([x, y, 0.6]) for x in (-0.15, 0.0, 0.15) for y in (-0.15, 0.0, 0.15)]
    q = np.array([world.project(replace(rig, centre=(642.0, 510.0)), board + place) for place in places])
    flat = data.corner_q.copy()
    flat[: len(q), : q.shape[1]] = q + 0.1 * random.normal(size=q.shape)
    with pytest.raises(CalibrationError, match="same tilt"):
        seed_camera(data._replace(corner_q=flat, fixes_pose=np.arange(len(data.fixes_pose)) < len(q)), "fisheye")
    nonsense = np.where(data.corner_valid[..., None], random.uniform(0, 1000, data.corner_q.shape), data.corner_q)
    with pytest.raises(CalibrationError, match="No wide-angle lens makes the corners"):
        seed_camera(data._replace(corner_q=nonsense), "fisheye")
