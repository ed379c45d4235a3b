"""Several devices share a sweep and give what one gives."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxscan.reconstruction import ReconstructSettings, Sweep, reconstruct
from jaxscan.stripes import NoiseModel

from .rendered import ELECTRONS_PER_DN, READ_DN, expose, stripe


pytestmark = pytest.mark.more


WIDTH, HEIGHT, RECORDS = 128, 48, 7
"""An odd number of records, of which the last chunk is padded."""
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
NOISE = NoiseModel(READ_DN, ELECTRONS_PER_DN)
FIELDS = ("xyz", "rgb", "normals", "sigma_random", "intensity", "valid")


KINDS = ("bracket", "plain", "steps")


def clouds(kinds):
    """Clouds of a bracket, of a plain sweep, and of one with all its candidates compared over the steps."""
    from .conftest import small_scanner, stripes_on_plane

    scanner = small_scanner(width=WIDTH, height=HEIGHT)
    phi = np.radians(np.arange(RECORDS))
    u, seen = stripes_on_plane(scanner, phi, NORMAL, 1.5)
    light = stripe(u, seen, 60.0, WIDTH) + stripe(u - 40.0, seen, 25.0, WIDTH)
    longer = np.array([1.0, 3.0])[:, None, None]
    room = np.random.default_rng(5).uniform(5.0, 15.0, light[:, None].shape)
    on, off = expose(longer * (light[:, None] + room), 1), expose(longer * room, 2)
    single = Sweep(on[:, 0], off[:, 0], phi)
    bracket = Sweep(on, off, phi, exposures=(1.0, 3.0))
    checked = ReconstructSettings(check_steps=True, chunk_records=3)
    plain = ReconstructSettings(chunk_records=3)
    of_kind = {"bracket": (bracket, plain), "plain": (single, plain), "steps": (single, checked)}
    return {
        kind: reconstruct(sweep, scanner, settings=settings, noise=NOISE)
        for kind, (sweep, settings) in of_kind.items()
        if kind in kinds
    }


def main(path, *kinds):
    """What the other process does."""
    fields = {f"{name} {kind}": getattr(cloud, name) for kind, cloud in clouds(kinds).items() for name in FIELDS}
    np.savez(path, devices=len(jax.local_devices()), **fields)


# A bracket goes all the ways that a plain sweep does: frames shared out, angles with their frames.
@pytest.mark.parametrize("kinds", [KINDS[:1], pytest.param(KINDS[1:], marks=pytest.mark.slow)], ids=",".join)
def test_two_devices_give_what_one_gives(tmp_path, kinds):
    """One device takes all frames of a chunk, two share them."""
    folder = Path(__file__).resolve().parent
    # The folder is a package to the process, as it is to pytest, so that relative imports work.
    code = (
        f"import sys; sys.path.insert(0, {str(folder.parent)!r}); "
        f"from {folder.name}.test_devices import main; main({str(tmp_path / 'two.npz')!r}, *{kinds})"
    )
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    kept = str(jax.config.jax_compilation_cache_dir)
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_COMPILATION_CACHE_DIR": kept}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert run.returncode == 0, run.stderr
    two = np.load(tmp_path / "two.npz")
    assert two["devices"] == 2
    for kind, cloud in clouds(kinds).items():
        assert cloud.valid.sum() > 0.9 * cloud.valid.size
        np.testing.assert_array_equal(two[f"valid {kind}"], cloud.valid)
        np.testing.assert_array_equal(two[f"rgb {kind}"], cloud.rgb)
        # Functions that are compiled otherwise round otherwise; the fit ends at what is left of it.
        np.testing.assert_allclose(two[f"xyz {kind}"], cloud.xyz, rtol=1e-5, atol=1e-5)
        # A sigma is good to a few per cent; it follows the width, which the data tell least of all.
        np.testing.assert_allclose(two[f"sigma_random {kind}"], cloud.sigma_random, rtol=1e-3)
        np.testing.assert_allclose(two[f"intensity {kind}"], cloud.intensity, rtol=1e-3)
        # Over a window of a few centimetres 1e-5 m are some 1e-4 of a direction.
        np.testing.assert_allclose(two[f"normals {kind}"], cloud.normals, atol=1e-3)
