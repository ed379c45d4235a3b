"""The paper's equations (3) to (11) as they stand: rays, boards, planes, motions."""

import cv2
import numpy as np


def rays(matrix: np.ndarray, k: float, uv: np.ndarray) -> np.ndarray:
    """Directions of pixels: equation (3) solved for the undistorted radius by Newton's method.

    Args:
        matrix: A [3, 3], px.
        k: The radial coefficient.
        uv: Pixels [..., 2].

    Returns:
        (x, y, 1) [..., 3], normalised coordinates.
    """
    distorted = np.stack([(uv[..., 0] - matrix[0, 2]) / matrix[0, 0], (uv[..., 1] - matrix[1, 2]) / matrix[1, 1]], -1)
    wanted = np.linalg.norm(distorted, axis=-1)
    radius = wanted.copy()
    for _ in range(8):
        radius -= (radius * (1 + k * radius**2) - wanted) / (1 + 3 * k * radius**2)
    out = np.ones((*wanted.shape, 3))
    out[..., :2] = distorted / (1 + k * radius**2)[..., None]
    return out


def points_on_board(matrix: np.ndarray, k: float, pose: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Points of a board at pixels: rays meet the board, equations (5) to (7).

    Args:
        matrix: A [3, 3], px.
        k: The radial coefficient.
        pose: T_cam_board [4, 4].
        uv: Pixels [n, 2].

    Returns:
        [n, 3], camera frame [m].
    """
    along, normal = rays(matrix, k, uv), pose[:3, 2]
    return along * ((normal @ pose[:3, 3]) / (along @ normal))[:, None]


def linear_plane(points: np.ndarray) -> np.ndarray:
    """a, b, c of a X + b Y + Z = c from points [n, 3] by linear least squares, equation (8)."""
    columns = np.column_stack([points[:, 0], points[:, 1], -np.ones(len(points))])
    return np.linalg.lstsq(columns, -points[:, 2], rcond=None)[0]


def total_plane(points: np.ndarray) -> np.ndarray:
    """a, b, c of the same by total least squares: the sum of squared distances from the plane is least."""
    middle, (_, _, normal) = principal_axes(points)
    return np.array([normal[0], normal[1], normal @ middle]) / normal[2]


def principal_axes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of points [n, 3], and unit rows [3, 3]: two directions in their plane of least squares, then its normal."""
    middle = points.mean(0)
    return middle, np.linalg.svd(points - middle, full_matrices=False)[2]


def rigid(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Motion [4, 4] of OpenCV's rotation vector [3, 1], rad, and translation [3, 1]."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return out


def pair_motion(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Tr [4, 4] from the poses of one board that is seen from two table positions, equation (10)."""
    return first @ np.linalg.inv(second)


def power(tr: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Tr^n [n, 4, 4], n any real numbers [n]: equation (11), by the logarithm of the motion.

    Source: exponential of a twist, Murray, Li and Sastry 1994, section 2.3.
    """
    turn = cv2.Rodrigues(np.ascontiguousarray(tr[:3, :3]))[0][:, 0]
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])

    def parts(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations by `theta`, and their integrals over the angle, [n, 3, 3]."""
        s, c, t = (part[:, None, None] for part in (np.sin(theta), np.cos(theta), theta))
        square = cross @ cross
        return np.eye(3) + s * cross + (1 - c) * square, t * np.eye(3) + (1 - c) * cross + (t - s) * square

    n = np.asarray(n, np.float64)
    out = np.zeros((len(n), 4, 4))
    out[:, 3, 3] = 1
    if angle == 0:
        out[:, :3, :3], out[:, :3, 3] = np.eye(3), n[:, None] * tr[:3, 3]
        return out
    velocity = np.linalg.solve(parts(np.array([angle]))[1][0], tr[:3, 3])
    out[:, :3, :3], carried = parts(n * angle)
    out[:, :3, 3] = carried @ velocity
    return out
