"""Gloss: a lobe of light round the direction of a mirror."""

import numpy as np


def lobe(to_light: np.ndarray, to_eye: np.ndarray, normal: np.ndarray, width: float) -> np.ndarray:
    """Strength of a lobe, 1 in its middle.

    Args:
        to_light: From points to the light [..., 3], of any length.
        to_eye: To the camera.
        normal: Unit normals towards the camera.
        width: Standard deviation of the angle between normal and bisector [rad].
    """
    half = _unit(to_light) + _unit(to_eye)
    cosine = np.clip(np.sum(_unit(half) * normal, -1), -1, 1)
    above = np.sum(to_light * normal, -1) > 0
    return np.where(above, np.exp(-0.5 * np.square(np.arccos(cosine) / width)), 0).astype(np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
