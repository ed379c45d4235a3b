"""A small cloud with everything in it: two lasers, holes, poison where nothing is valid."""

import numpy as np

from jaxscan.reconstruction import PointCloud


PROFILES, LINES = 6, 5


def make_cloud(*, dtype=np.float32, seed=0, smoothed=False):
    rng = np.random.default_rng(seed)
    valid = rng.random((PROFILES, LINES)) < 0.7
    valid[0, 0], valid[2] = True, False
    grid = (PROFILES, LINES)

    def field(values, poison):
        mask = valid.reshape(grid + (1,) * (values.ndim - 2))
        return np.where(mask, values, np.asarray(poison, values.dtype))

    normals = rng.normal(size=(*grid, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    smooth = {
        "sigma_row": field(rng.uniform(1e-4, 1e-2, grid).astype(dtype), 50),
        "shift_px": field(rng.normal(size=grid).astype(dtype), 60),
        "shared_lines": field(rng.uniform(1, 20, grid).astype(dtype), 70),
    }
    return PointCloud(
        xyz=field(rng.uniform(-4, 4, (*grid, 3)).astype(dtype), 99),
        rgb=field(rng.integers(0, 256, (*grid, 3), np.uint8), 77),
        intensity=field(rng.uniform(5, 300, grid).astype(dtype), 1e4),
        normals=field(normals.astype(dtype), 5),
        sigma_random=field(rng.uniform(1e-4, 1e-2, grid).astype(dtype), 50),
        sigma_systematic=field(rng.uniform(1e-4, 1e-2, grid).astype(dtype), 50),
        valid=valid,
        record=np.repeat(np.arange(PROFILES // 2, dtype=np.int32), 2),
        laser=np.tile(np.arange(2, dtype=np.int32), PROFILES // 2),
        angle=np.linspace(0, 2, PROFILES),
        **(smooth if smoothed else {}),
    )


def unsealed(path):
    """Bytes of a file without the digest that tells a change: a test edits them, and so may a program."""
    return path.read_bytes().replace(b"seal blake2b", b"mark blake2b")
