"""The same points scanned again, with the scanner moved by one standard deviation along each independent direction.

Nothing is differentiated: half of the change from back to forth stands for the derivative.
"""

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Rig, Scanner, lit_points, root_of, transform


def sigma_steps(scanner: Scanner) -> np.ndarray:
    """No step, then one standard deviation forth along each independent direction, then back [steps, params].

    Raises:
        ValueError: If the scanner has no covariance.
    """
    if scanner.covariance is None:
        raise ValueError("The scanner has no covariance, so nothing can be said about its lengths.")
    return both_ways(root_of(np.asarray(scanner.covariance, np.float64)))


def both_ways(steps: Float[np.ndarray, "steps params"]) -> np.ndarray:
    """No step, then the given ones forth, then back [1 + 2 steps, params]."""
    return np.concatenate([np.zeros((1, steps.shape[1])), steps, -steps])


def change(values: np.ndarray) -> np.ndarray:
    """Half of the change of a quantity [steps, ...] from back to forth, for each direction."""
    count = len(values) // 2
    return (values[1 : 1 + count] - values[1 + count :]) / 2.0


def sigma_of(values: np.ndarray) -> np.ndarray:
    """Standard deviation of a quantity [steps, ...] at the steps of `sigma_steps`."""
    return np.sqrt(np.sum(change(values) ** 2, axis=0))


def camera_points(
    rig: Rig, q: np.ndarray, laser: np.ndarray | int, angle: np.ndarray | float = 0.0
) -> Float[np.ndarray, "points 3"]:
    """Points in the camera frame at angle 0 [m]."""
    return np.asarray(transform(rig.motion.motion(np.asarray(angle, np.float64)), lit_points(rig, q, laser)[0]))


def scan_points(
    scanner: Scanner, steps: np.ndarray, q: np.ndarray, laser: np.ndarray | int, angle: np.ndarray | float = 0.0
) -> np.ndarray:
    """`camera_points` with the scanner moved by each step [steps, points, 3]."""
    return np.stack([camera_points(scanner.rig.retract(step), q, laser, angle) for step in steps])
