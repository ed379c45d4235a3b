r"""Rays of pixels, the points where they meet the laser, with derivatives, and the pixels at which points are seen.

With the ray $v(q)$ of the camera, the sheet's distance $d$ and incidence $m$, and the pose $T(\varphi)$ of the motion,
the point of a stripe is

$$p = T(\varphi) \, \frac{d}{m(v(q))} \, v(q).$$

All functions work over any leading axes, which broadcast, in float32 or float64. NumPy arrays give NumPy arrays, and
nothing is compiled; with JAX arrays all can be traced, mapped and differentiated, by the rig's arrays, the pixels and
the positions.

Source: the paper, equations (1)-(4), (10)-(12).
"""

from jaxtyping import Float, Int

from jaxscan.geometry.arrays import Array, Component, namespace, real
from jaxscan.geometry.rig import Rig
from jaxscan.geometry.rigid import compose, invert, transform, turn


def rays(rig: Rig, q: Float[Array, "... 2"]) -> Float[Array, "... 3"]:
    """Unit rays of pixels.

    Args:
        rig: The rig.
        q: Pixels (u, v) [px]. Those outside the image of a wide lens get the ray of the largest angle on their side.

    Returns:
        Unit rays, camera frame.
    """
    return rig.camera.unproject(real(q))


def poses(rig: Rig, phi: Float[Array, "..."] | float) -> Float[Array, "... 4 4"]:
    """T_scanner_cam at the table's angles [rad from home], or positions of a stage [m]."""
    motion = rig.motion.motion(real(phi))
    return compose(rig.motion.frame().astype(motion.dtype), motion)


def pixels(rig: Rig, p: Float[Array, "... 3"], phi: Float[Array, "..."] | float) -> Float[Array, "... 2"]:
    """Project points into the image.

    Args:
        rig: The rig.
        p: Points, scanner frame [m]. Of those behind the camera the result means nothing.
        phi: The table's angles [rad from home], or positions of a stage [m].

    Returns:
        Pixels (u, v) [px].
    """
    return rig.camera.project(transform(invert(poses(rig, phi)), real(p)))


def lit_points(
    rig: Rig, q: Float[Array, "... 2"], laser: int | Int[Array, "..."]
) -> tuple[Float[Array, "... 3"], Float[Array, "..."]]:
    """Points of stripes in the camera frame, whatever the motion.

    Args:
        q: Stripe centres (u, v) [px].
        laser: Number of the sheet that lit each.

    Returns:
        p_cam: Points [m]; 0 where the ray misses the sheet.
        incidence: See `LaserSheet.intersect`; positive where the point exists.
    """
    ray = rays(rig, q)
    range_m, incidence = rig.laser(laser).intersect(ray)
    return range_m[..., None] * ray, incidence


def points(
    rig: Rig, q: Float[Array, "... 2"], laser: int | Int[Array, "..."], phi: Float[Array, "..."] | float
) -> Float[Array, "... 3"]:
    """Intersect the rays of stripes with their laser sheets.

    Args:
        rig: The rig.
        q: Stripe centres (u, v) [px].
        laser: Number of the sheet that lit each.
        phi: The table's angles [rad from home], or positions of a stage [m].

    Returns:
        Points, scanner frame [m]; the camera's centre where a ray misses the sheet.
    """
    return transform(poses(rig, phi), lit_points(rig, q, laser)[0])


def slopes(
    rig: Rig, q: Float[Array, "... 2"], laser: int | Int[Array, "..."], phi: Float[Array, "..."] | float
) -> Float[Array, "... 3 2"]:
    """Derivatives of `points` by their pixels.

    Args:
        rig: The rig.
        q: Stripe centres (u, v) [px].
        laser: Number of the sheet that lit each.
        phi: The table's angles [rad from home], or positions of a stage [m].

    Returns:
        Derivatives of the points by u and v [m / px]; 0 where a ray misses the sheet.
    """
    p, incidence = lit_points(rig, q, laser)
    found = lit_slopes(rig, p, incidence, laser)
    rotation = poses(rig, phi)[..., :3, :3]
    return namespace(found, rotation).stack([turn(rotation, found[..., k]) for k in range(2)], -1)


def lit_slopes(
    rig: Rig, p_cam: Float[Array, "... 3"], incidence: Float[Array, "..."], laser: int | Int[Array, "..."]
) -> Float[Array, "... 3 2"]:
    """Derivatives of `lit_points` by the pixel [m / px], of what it returned; 0 where the ray misses the sheet.

    A point moves so that its pixel moves by one and its offset from the sheet stays 0: three linear equations.
    """
    xp = namespace(rig, p_cam)
    hits = incidence > 0
    # A dummy point in front of the camera where there is none, so that neither value nor gradient is NaN.
    x, y, z = (xp.where(hits, p_cam[..., k], 1.0 * (k == 2)).astype(p_cam.dtype) for k in range(3))
    p = xp.stack([x, y, z], -1)
    by_point, normal = rig.camera.slopes(p), rig.laser(laser).slope(p)
    by_u, by_v = by_point[..., 0, :], by_point[..., 1, :]
    along_u, along_v = _cross(by_v, normal), _cross(normal, by_u)
    volume = sum(by_u[..., k] * along_u[k] for k in range(3))
    exists = hits & (volume != 0)
    scale = xp.where(exists, 1.0 / xp.where(exists, volume, 1.0), 0.0).astype(p_cam.dtype)
    return xp.stack([xp.stack([u * scale, v * scale], -1) for u, v in zip(along_u, along_v, strict=True)], -2)


def _cross(a: Array, b: Array) -> tuple[Component, Component, Component]:
    (ax, ay, az), (bx, by, bz) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
