"""What every estimator must do, to be inherited: see `test_estimators.py`."""

import numpy as np
import pytest

from jaxscan.stripes import ESTIMATORS, FrameFormat, LaserLine, NoiseModel, StripeSettings, extract_stripes


KNOWN = NoiseModel(read_dn=1.0, electrons_per_dn=40.0)


class EstimatorContract:
    """Inherit, and name the estimator; the public call is all that is used."""

    name: str
    bias_px = 0.01
    """Largest mean error over the sub-pixel phase."""
    worst_ratio = 1.2
    """Largest root mean square of the error, over the Cramer-Rao bound."""

    def extract(self, on, off, **words):
        choice = words.pop("choice", "path")
        settings = StripeSettings(estimator=self.name, choice=choice)
        return extract_stripes(on, off, settings=settings, noise=KNOWN, **words)

    def errors(self, stripes, u):
        found = np.asarray(stripes.valid)[0]
        return (np.asarray(stripes.u)[0] - u)[found], np.asarray(stripes.sigma)[0][found], found

    @pytest.mark.parametrize("width", [1.0, 2.0, 3.0])
    def test_centres_are_true_and_sigma_is_honest(self, render, bound, width):
        scene = render(width, 100.0)
        error, sigma, found = self.errors(self.extract(scene.on, scene.off), scene.u)
        assert found.mean() > 0.99
        phase = np.floor(4 * (scene.u[found] % 1.0)).astype(int)
        assert max(abs(error[phase == k].mean()) for k in range(4)) < self.bias_px
        # 2048 rows tell a root mean square to 1.6 %.
        assert np.sqrt(np.mean(error**2)) < self.worst_ratio * bound(width, 100.0)
        assert 0.85 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.15

    def test_without_laser_off_frames(self, render):
        scene = render(2.0, 100.0)
        error, sigma, found = self.errors(self.extract(scene.on, None), scene.u)
        assert found.mean() > 0.99
        assert 0.8 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.2

    def test_empty_rows_hold_no_stripe(self, render):
        scene = render(1.0, 0.0, columns=640, rows=2048)
        stripes = self.extract(scene.on, scene.off)
        valid = np.asarray(stripes.valid)
        assert valid.mean() < 0.004
        for name in ("u", "sigma", "amplitude", "width", "chi2", "saturated"):
            assert np.all(np.asarray(getattr(stripes, name))[~valid] == 0), name

    def test_columns_are_rows_turned(self, render):
        scene = render(1.5, 80.0, rows=64)
        upright = self.extract(scene.on, scene.off)
        lying = self.extract(scene.on.swapaxes(1, 2), scene.off.swapaxes(1, 2), line=LaserLine(stripe_axis="columns"))
        np.testing.assert_array_equal(np.asarray(upright.valid), np.asarray(lying.valid))
        # Sums of float32 in another order.
        np.testing.assert_allclose(np.asarray(upright.u), np.asarray(lying.u), atol=1e-3)

    @pytest.mark.more
    @pytest.mark.parametrize(("pixel_format", "colour"), [("bayer_rggb8", "red"), ("bayer_rggb8", "green")])
    def test_the_sites_of_a_mosaic(self, render, pixel_format, colour):
        scene = render(2.5, 120.0, rows=512)
        stripes = self.extract(scene.on, scene.off, pixel_format=pixel_format, line=LaserLine(colour=colour))
        error, sigma, found = self.errors(stripes, scene.u)
        assert found.mean() > (0.98 if colour == "green" else 0.49)
        assert 0.8 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.25

    def test_rgb_is_the_channel_of_the_laser(self, render):
        scene = render(1.5, 80.0, rows=64)
        dark = np.zeros_like(scene.on)
        on, off = (np.stack([dark, frame, dark], -1) for frame in (scene.on, scene.off))
        rgb = self.extract(on, off, pixel_format=FrameFormat("rgb8"), line=LaserLine(colour="green"))
        np.testing.assert_array_equal(np.asarray(rgb.u), np.asarray(self.extract(scene.on, scene.off).u))

    @pytest.mark.parametrize("choice", ["path", "brightest", "nearest", "farthest", "all"])
    def test_a_choice_is_made_or_refused_in_one_line(self, render, choice):
        scene = render(1.5, 80.0, rows=64)
        if choice in ESTIMATORS[self.name].choices and choice not in ("nearest", "farthest"):
            stripes = self.extract(scene.on, scene.off, choice=choice)
            assert stripes.u.shape[0] == (ESTIMATORS[self.name].candidates if choice == "all" else 1)
            return
        with pytest.raises(ValueError, match=choice) as problem:
            self.extract(scene.on, scene.off, choice=choice)
        assert "\n" not in str(problem.value)

    def test_a_single_image_is_one_profile(self, render):
        scene = render(1.5, 80.0, rows=64)
        single, stack = self.extract(scene.on[0], scene.off[0]), self.extract(scene.on, scene.off)
        assert single.u.shape == (1, 64)
        np.testing.assert_array_equal(np.asarray(single.u), np.asarray(stack.u))
