"""Error of the centre against the Cramer-Rao bound, its bias, and the honesty of sigma."""

import numpy as np
import pytest

from jaxscan.stripes import NoiseModel, extract_stripes


KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)


def _errors(scene, **options):
    stripes = extract_stripes(scene.on, scene.off, noise=KNOWN, **options)
    valid = np.asarray(stripes.valid)[0]
    return np.asarray(stripes.u)[0] - scene.u, np.asarray(stripes.sigma)[0], valid, stripes


def _check(width, amplitude, render, bound, *, rows, columns=96, margin):
    error, sigma, valid, stripes = _errors(render(width, amplitude, rows=rows, columns=columns))
    # At 20 DN a stripe is 12 sigma of the difference: none may be missed but for rare fits.
    assert valid.mean() > 0.995
    error, sigma = error[valid], sigma[valid]
    ratio = np.sqrt(np.mean(error**2)) / bound(width, amplitude)
    # The bound is for many photons; a twentieth is allowed for 12 sigma stripes. `margin` is
    # three standard errors of a root mean square over that many rows.
    assert ratio <= 1.05 + margin
    # An error below the bound would mean that bound or renderer are wrong.
    assert ratio >= 0.97 - margin
    assert 0.95 - margin <= np.sqrt(np.mean((error / sigma) ** 2)) <= 1.05 + margin
    assert abs(np.mean(np.asarray(stripes.chi2)[0][valid]) - 1.0) < 0.05
    assert np.median(np.asarray(stripes.width)[0][valid]) == pytest.approx(width, rel=0.03)
    assert np.median(np.asarray(stripes.amplitude)[0][valid]) == pytest.approx(amplitude, rel=0.03)


@pytest.mark.parametrize(("width", "amplitude"), [(1.0, 20.0), (1.5, 180.0), (2.0, 60.0), (3.0, 20.0)])
def test_centre_reaches_the_bound(width, amplitude, render, bound):
    _check(width, amplitude, render, bound, rows=2048, margin=3 / np.sqrt(2 * 2048))


@pytest.mark.slow
@pytest.mark.parametrize("width", [1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0])
@pytest.mark.parametrize("amplitude", [20.0, 40.0, 60.0, 120.0, 180.0, 240.0])
def test_centre_reaches_the_bound_everywhere(width, amplitude, render, bound):
    _check(width, amplitude, render, bound, rows=20000, columns=128, margin=3 / np.sqrt(2 * 20000))


@pytest.mark.parametrize("width", [0.7, 1.0, 1.5, 3.0])
def test_no_bias_over_the_phase(width, render):
    u = 48.0 + np.linspace(-0.5, 0.5, 2048, endpoint=False)
    error, sigma, valid, _ = _errors(render(width, 180.0, u=u))
    assert np.all(valid)
    phases = error.reshape(8, 256)
    # 0.005 px is what is promised; three standard errors of a mean over 256 rows come on top.
    allowed = 0.005 + 3 * sigma.mean() / np.sqrt(256)
    assert np.all(np.abs(phases.mean(1)) < allowed)


def test_without_noise_only_rounding_is_left(render):
    scene = render(1.5, 200.0, noise=False)
    error, _, valid, _ = _errors(scene)
    assert np.all(valid)
    # Rounding of two frames is 0.41 DN in the difference, a quarter of the usual noise: the
    # bound with that noise alone is 0.0022 px.
    assert np.sqrt(np.mean(error**2)) < 0.003


# Five times the range at 600 DN; the half-maximum width then is up to 18 px.
@pytest.mark.parametrize(("width", "amplitude"), [(1.0, 600.0), (1.5, 600.0), (2.0, 600.0), (3.0, 600.0), (5.0, 600.0)])
def test_over_exposed_stripe(width, amplitude, render, bound):
    error, sigma, valid, stripes = _errors(render(width, amplitude))
    assert valid.mean() > 0.99
    assert np.sqrt(np.mean(error[valid] ** 2)) <= 0.02
    # Wide clipped stripes are binned, which costs part of the few flank pixels.
    assert np.sqrt(np.mean(error[valid] ** 2)) <= 1.25 * bound(width, amplitude)
    assert 0.9 <= np.sqrt(np.mean((error / sigma)[valid] ** 2)) <= 1.1
    # The clipped part of a Gaussian is 2 w sqrt(2 ln(A / 244)) wide; one pixel either way.
    clipped = 2 * width * np.sqrt(2 * np.log(amplitude / 244.0))
    assert np.median(np.asarray(stripes.saturated)[0]) == pytest.approx(clipped, abs=1.0)


def test_undersampled_stripe(render, bound):
    error, sigma, valid, _ = _errors(render(0.7, 60.0))
    assert valid.mean() > 0.99
    ratio = np.sqrt(np.mean(error[valid] ** 2)) / bound(0.7, 60.0)
    assert 0.9 < ratio < 1.1
    assert 0.9 < np.sqrt(np.mean((error / sigma)[valid] ** 2)) < 1.1


@pytest.mark.more
def test_without_laser_off_frame(render, bound):
    for width, amplitude in ((1.0, 60.0), (2.0, 60.0), (3.0, 180.0)):
        scene = render(width, amplitude, ambient=40.0)
        stripes = extract_stripes(scene.on, None, noise=KNOWN)
        valid = np.asarray(stripes.valid)[0]
        assert valid.mean() > 0.995
        error = (np.asarray(stripes.u)[0] - scene.u)[valid]
        limit = bound(width, amplitude, ambient=40.0, has_off=False)
        assert np.sqrt(np.mean(error**2)) < 1.1 * limit
        assert 0.9 < np.sqrt(np.mean((error / np.asarray(stripes.sigma)[0][valid]) ** 2)) < 1.1
        # The free background takes a third of what is known about the amplitude, no bias.
        assert np.median(np.asarray(stripes.amplitude)[0][valid]) == pytest.approx(amplitude, rel=0.04)
