"""Two covariances of one scanner, direction by direction: the information that the data added to the prior."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Compared(NamedTuple):
    r"""A prior and a posterior covariance in the directions in which they differ one by one.

    With $C_0 = L L^T$ and $L^{-1} C_1 L^{-T} = V \Lambda V^T$, a step $L v_i$ was one standard deviation before and is
    $\sqrt{\lambda_i}$ after. Parameters that are held have no part in any direction.
    """

    prior: Float[np.ndarray, "params params"]
    posterior: Float[np.ndarray, "params params"]
    direction: Float[np.ndarray, "params directions"]
    """Steps of one standard deviation of the prior, as columns; best known after last."""
    whiten: Float[np.ndarray, "directions params"]
    """Of a step: its part in each direction, in units of the prior's standard deviation."""
    ratio: Float[np.ndarray, " directions"]
    """Variance after over that before [1]."""

    @property
    def factor(self) -> Float[np.ndarray, " directions"]:
        """Old over new standard deviation of each direction [1]."""
        return 1.0 / np.sqrt(self.ratio)

    def chance_variance(self) -> Float[np.ndarray, "params params"]:
        """Covariance of the departure where nothing moved: that before less that after."""
        return (self.direction * (1.0 - self.ratio)) @ self.direction.T


# Beyond this the prior's directions cannot be told from rounding.
_ROUNDING = 1e-13


def compare(prior: Float[np.ndarray, "params params"], posterior: Float[np.ndarray, "params params"]) -> Compared:
    """Two covariances side by side, by their generalised eigenvalues.

    Args:
        prior: Covariance before, in px, rad and m; a parameter of variance 0 is held.
        posterior: After, in the same order.
    """
    prior, posterior = np.asarray(prior, np.float64), np.asarray(posterior, np.float64)
    unit = np.sqrt(np.maximum(np.diag(prior), 0.0))
    free = unit > 0
    unit = unit[free]
    # Pixels and radians differ by a million: in units of sigma all parameters are of one size.
    values, vectors = np.linalg.eigh(prior[np.ix_(free, free)] / np.outer(unit, unit))
    held = values <= _ROUNDING * values[-1] if len(values) else np.zeros(0, bool)
    values, vectors = values[~held], vectors[:, ~held]
    root = unit[:, None] * vectors * np.sqrt(values)
    inverse = (vectors / np.sqrt(values)).T / unit
    after = inverse @ posterior[np.ix_(free, free)] @ inverse.T
    ratio, turned = np.linalg.eigh((after + after.T) / 2.0)
    ratio, turned = ratio[::-1], turned[:, ::-1]
    direction, whiten = np.zeros((len(prior), len(ratio))), np.zeros((len(ratio), len(prior)))
    direction[free], whiten[:, free] = root @ turned, turned.T @ inverse
    return Compared(prior, posterior, direction, whiten, np.maximum(ratio, _ROUNDING))


def with_prior(
    loose: Compared, step: Float[np.ndarray, " params"], prior: Float[np.ndarray, "params params"]
) -> tuple[Compared, Float[np.ndarray, " params"]]:
    """A solve with a loose prior, as it would have come out with a tighter one, to first order.

    A scanner that moved beyond a tight prior would leave bent walls, which would be taken for noise. So the data speak
    by a solve that lets everything move.

    Args:
        loose: Prior and posterior of that solve.
        step: From the stored scanner to its result.
        prior: The tighter covariance.

    Returns:
        Prior and posterior covariance, and the step, with the tighter prior.
    """
    information = np.maximum(1.0 / loose.ratio - 1.0, 0.0)
    gradient = (loose.whiten @ step) / loose.ratio
    values, vectors = np.linalg.eigh(loose.whiten @ np.asarray(prior, np.float64) @ loose.whiten.T)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.inv(np.eye(len(values)) + root.T @ (information[:, None] * root))
    posterior = loose.direction @ (root @ inner @ root.T) @ loose.direction.T
    return compare(prior, posterior), loose.direction @ (root @ (inner @ (root.T @ gradient)))
