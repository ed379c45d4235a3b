"""Centres where speckle rules: error over the limit of coherent light per row and along the line, and honest sigmas.

A camera of 8 e-/DN, read noise 1.7 DN and black level 5 DN sees a stripe of 1.3 px (standard deviation) on gently
curved surfaces; its peak goes from 30 to 230 DN along the rows, so that grains clip. All is learned from the frames.
"""

import numpy as np
from tables.stripe_table import Figure
from worlds.speckle_world import Course, Speckle, render_coherent
from worlds.stripe_world import Sensor

import jaxscan
from jaxscan.reconstruction.along import smooth_sweep


CONTRASTS, F_NUMBERS = (1.0, 0.5, 0.2), (2.8, 5.6, 8.0)
_SENSOR = Sensor(read_dn=1.7, electrons_per_dn=8.0, ambient_dn=0.0, black_dn=5.0)
_WIDTH, _ROWS, _COLUMNS, _FRAMES = 1.3, 512, 192, 12
_CLASSES = ((30.0, 80.0), (80.0, 130.0), (130.0, 180.0), (180.0, 230.0))
"""Amplitudes [DN]."""


def measure_speckle(*, quick: bool, seed: int) -> list[Figure]:
    """Figures of every contrast and aperture."""
    out = []
    for contrast in CONTRASTS:
        for f_number in F_NUMBERS:
            out += _figures(Speckle(contrast, f_number), 4 if quick else _FRAMES, seed)
    return out


def _figures(speckle: Speckle, frames: int, seed: int) -> list[Figure]:
    rng = np.random.default_rng([seed, 41, round(100 * speckle.contrast), round(10 * speckle.f_number)])
    v = (np.arange(_ROWS) - _ROWS / 2) / _ROWS
    middle, tilt, sag = (rng.uniform(-a, a, (frames, 1)) for a in (2.0, 8.0, 6.0))
    u = _COLUMNS / 2 + middle + tilt * v + sag * v**2
    amplitude = 130.0 - 100.0 * np.cos(8 * np.pi * v)
    room = np.linspace(3.0, 70.0, _COLUMNS)[None, :] * np.linspace(1.0, 0.4, _ROWS)[:, None]
    pairs = render_coherent(Course(u, _WIDTH, amplitude), room, speckle, _SENSOR, rng)
    found = jaxscan.extract_stripes(pairs.on, pairs.off)
    centre, sigma, valid = (np.asarray(field) for field in (found.u, found.sigma, found.valid))
    key = f"speckle_{speckle.contrast:g}_at_f{speckle.f_number:g}"
    level = np.broadcast_to(amplitude, u.shape)
    honest = [_ratio(sigma, centre - u, valid & (level >= low) & (level < high)) for low, high in _CLASSES]
    far = np.abs(centre - u)[valid] > 5 * sigma[valid]
    out = [
        Figure(f"{key}_limit", speckle.limit_px, "px"),
        Figure(f"{key}_valid", float(valid[pairs.snr > 5].mean()), "of rows with light over 5 sigma", low=0.99),
        Figure(f"{key}_row_rms_over_limit", _rms((centre - u)[valid]) / speckle.limit_px, "1"),
        Figure(f"{key}_row_sigma_over_error", _ratio(sigma, centre - u, valid), "1", 0.9, 1.1),
        Figure(f"{key}_row_sigma_over_error_least_of_4_amplitudes", min(honest), "1", 0.9, 1.1),
        Figure(f"{key}_row_sigma_over_error_most_of_4_amplitudes", max(honest), "1", 0.9, 1.1),
        Figure(f"{key}_row_beyond_5_sigma", float(np.mean(far)), "of rows", high=1e-3),
    ]
    line = smooth_sweep(found)
    error = line.u - u
    return [
        *out,
        Figure(f"{key}_line_rms_over_limit", _rms(error[valid]) / speckle.limit_px, "1"),
        Figure(f"{key}_line_sigma_over_error", _ratio(line.sigma, error, valid), "1", 0.9, 1.1),
    ]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _ratio(sigma: np.ndarray, error: np.ndarray, valid: np.ndarray) -> float:
    """Stated over true, both root mean square."""
    return _rms(sigma[valid]) / _rms(error[valid])
