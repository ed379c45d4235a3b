"""Rooms scanned with a rig whose calibration errs as its covariance says: rays, with noise of the stripes in pixels."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.reconstruction import PointCloud

from ..measurement.rooms import AT, reach_of


TRUE_RIG = Scanner.from_parts(
    Pinhole(*map(np.asarray, (410.0, 410.0, 319.5, 255.5)), np.zeros(5), 640, 512, np.asarray(0.0)),
    LaserSheet.from_plane([0.99025, 0.0, 0.13927], 0.44563),
    Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.05]),
)
SIGMAS = {"f": 0.03, "c": 0.03, "k": 1e-4, "p": 2e-5, "laser.laser.n": 3e-5, "laser.laser.d": 2e-5, "axis": 3e-5}
"""Standard deviations by the beginnings of parameters' names [px, rad, m], a few times the demo's; others 0."""
ANGLES = ("gain", "c1", "s1", "c2", "s2")
ANGLE_SIGMA = 3e-4
"""Of the turntable's scale [1] and harmonics [rad], as the demo's."""
STRIPE_PX = 0.1


def covariance():
    """Of the calibration: every parameter by itself."""
    names = TRUE_RIG.parameter_names()
    size = [next((value for start, value in SIGMAS.items() if name.startswith(start)), 0.0) for name in names]
    return np.diag([ANGLE_SIGMA if name in ANGLES else one for name, one in zip(names, size, strict=True)]) ** 2


def scanned_room(corners, *, seed, profiles=180, rows=100, niches=(), boxes=()):
    """A cloud of a room as a rig sees it that is not quite as its calibration says, and that calibration.

    Place and direction of the rig are drawn, too.

    What the laser lights and the camera does not see has no point.
    """
    rng = np.random.default_rng(seed)
    spread = covariance()
    with jax.enable_x64(True):
        step = jnp.asarray(rng.multivariate_normal(np.zeros(len(spread)), spread))
        rig = TRUE_RIG.as_dtype(jnp.float64)
        known = rig.retract(step)
        phi = np.linspace(-np.pi, np.pi, profiles, endpoint=False)
        poses = np.asarray(jax.vmap(rig.pose)(jnp.asarray(phi)))
        sheet = rig.laser(0)
        normal = np.asarray(sheet.normal)
        forward = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        forward /= np.linalg.norm(forward)
        fan = np.radians(np.linspace(-30.0, 30.0, rows))[:, None]
        way = np.cos(fan) * forward + np.sin(fan) * np.cross(normal, forward)
        laser = np.asarray(sheet.distance) * normal
        yaw = rng.uniform(-np.pi, np.pi)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        at = AT + rng.uniform(-0.2, 0.2, 3)
        rotations, eyes = turn @ poses[:, :3, :3], at + poses[:, :3, 3] @ turn.T
        out = np.einsum("nij,rj->nri", rotations, way)
        sources = (eyes + rotations @ laser)[:, None]
        lit = sources + reach_of(corners, sources, out, niches=niches, boxes=boxes)[..., None] * out
        back = lit - eyes[:, None]
        seen = reach_of(corners, eyes[:, None], back, niches=niches, boxes=boxes) > 1.0 - 1e-6
        in_camera = np.einsum("nji,nrj->nri", rotations, back)
        q = np.asarray(jax.vmap(jax.vmap(rig.camera.project))(jnp.asarray(in_camera)))
        seen &= ((q > 0) & (q < [rig.camera.width - 1, rig.camera.height - 1])).all(-1)
        q = q + STRIPE_PX * rng.normal(size=seen.shape)[..., None] * [1.0, 0.0]
        points, sigma = (np.asarray(each) for each in _reconstructed(known, jnp.asarray(q), jnp.asarray(phi)))
    cloud = PointCloud(
        xyz=np.where(seen[..., None], points, 0.0).astype(np.float32),
        rgb=np.full((*seen.shape, 3), 128, np.uint8),
        intensity=np.full(seen.shape, 100.0, np.float32),
        normals=np.zeros((*seen.shape, 3), np.float32),
        sigma_random=np.where(seen, sigma, 0.0).astype(np.float32),
        sigma_systematic=np.zeros(seen.shape, np.float32),
        valid=seen,
        record=np.arange(profiles),
        laser=np.zeros(profiles, np.int32),
        angle=phi.astype(np.float32),
    )
    calibration = jax.tree.map(np.asarray, known)
    return cloud, Scanner(
        calibration.camera, calibration.lasers, calibration.turntable, spread, rig.laser_names, rig.up
    )


@jax.jit
def _reconstructed(rig, q, phi):
    """Points [profiles, rows, 3] and their standard deviations along the ray [profiles, rows]."""

    def one(q, phi):
        point = rig.point(q, 0, phi)[0]
        beside = rig.point(q + jnp.array([0.1, 0.0]), 0, phi)[0]
        return point, STRIPE_PX * jnp.linalg.norm(beside - point) / 0.1

    return jax.vmap(lambda row, angle: jax.vmap(lambda each: one(each, angle))(row))(q, phi)
