"""Every parameter before and after, and by how many standard deviations it moved."""

import jax
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.recalibration.judge.compared import Compared
from jaxscan.recalibration.judge.parts import unit_of
from jaxscan.recalibration.result import Moved


# A change whose chance variance is a smaller share of the prior's says nothing.
_TOLD = 1e-6


def moved_parameters(
    stored: Scanner,
    step: Float[np.ndarray, " params"],
    compared: Compared,
    loosened: Float[np.ndarray, "params params"],
) -> tuple[Moved, ...]:
    r"""The change of every parameter that the stored calibration does not hold.

    With the prior $C_0 + D$ of a solve, its gain $G = I - C_1 (C_0 + D)^{-1}$, and a departure that is by chance alone,
    the change has the covariance $G C_0 G^T + G C_1$, which is $C_0 - C_1$ where nothing was loosened.

    Args:
        stored: Its covariance is the prior.
        step: From it to the new scanner.
        compared: The solve's prior and posterior.
        loosened: What was added to the stored covariance, D.
    """
    kept = (compared.direction * (1.0 - compared.ratio)) @ compared.whiten
    prior = compared.prior - loosened
    chance = kept @ prior @ kept.T + kept @ compared.posterior
    before, sigma = start_values(stored), np.sqrt(np.maximum(np.diag(prior), 0.0))
    after = np.sqrt(np.maximum(np.diag(compared.posterior), 0.0))
    found = []
    for i, name in enumerate(stored.parameter_names()):
        if sigma[i] > 0:
            own = max(float(chance[i, i]), 0.0)
            size = float(step[i]) / np.sqrt(own) if own > _TOLD * sigma[i] ** 2 else 0.0
            value = float(before[i])
            told = (float(sigma[i]), float(after[i]), float(size), *unit_of(name))
            found.append(Moved(name, value, value + float(step[i]), *told))
    return tuple(found)


def start_values(stored: Scanner) -> Float[np.ndarray, " params"]:
    """Values of the minimal coordinates of the stored scanner; 0 for those of a direction or a foot point.

    They are tangent vectors of their own: their values are steps from the stored scanner.
    """
    with jax.enable_x64(True):
        camera = np.asarray(stored.camera.parameters(), np.float64)
    sheets = [
        np.concatenate([np.zeros(2), [float(stored.lasers.distance[i])], np.asarray(stored.lasers.bow[i])])
        for i in range(len(stored.laser_names))
    ]
    table = stored.turntable
    angles = [np.zeros(4), [float(table.gain)], np.asarray(table.harmonics)] if isinstance(table, Turntable) else []
    found = np.concatenate([camera, *sheets, *angles])
    return np.pad(found, (0, len(stored.parameter_names()) - len(found)))
