"""Every estimator keeps the contract, and the registry knows no other."""

import numpy as np
import pytest

from jaxscan.stripes import (
    ESTIMATORS,
    ExtractionSetup,
    FrameFormat,
    LaserLine,
    LineGate,
    StripeSettings,
    estimator_of,
    prepare_engines,
)

from .estimator_contract import KNOWN, EstimatorContract


class TestGaussian(EstimatorContract):
    name = "gaussian"


class TestCentreOfGravity(EstimatorContract):
    name = "centre_of_gravity"
    # The threshold lies between samples, and the blur costs width: a sixth of the information at 1 px.
    bias_px = 0.03
    worst_ratio = 1.6


def test_every_estimator_is_tried():
    assert {kind.name for kind in EstimatorContract.__subclasses__()} == set(ESTIMATORS)


def test_an_unknown_name_is_answered_with_those_that_are_known():
    with pytest.raises(ValueError, match="Unknown estimator 'parabola'; known: gaussian, centre_of_gravity"):
        estimator_of(StripeSettings(estimator="parabola"))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_stripes_outside_the_gate_are_not_seen(render, name):
    scene = render(1.5, 100.0, rows=64, u=np.full(64, 40.0))
    settings = StripeSettings(estimator=name, learn_width=False)
    setup = ExtractionSetup((96, 64), FrameFormat(), LaserLine(), settings)
    for low, found in ((20, True), (60, False)):
        gate = LineGate(np.full(64, low), np.full(64, 96), 1)
        (engine,) = prepare_engines(scene.on, scene.off, [setup], noise=KNOWN, gates=[gate])
        assert np.asarray(engine.extract(scene.on, scene.off).stripes.valid).mean() == found
