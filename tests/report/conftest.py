"""A calibration made up for drawing: names, numbers and residuals that no solve has seen."""

import dataclasses

import numpy as np
import pytest

from jaxscan.calibration import (
    Calibration,
    Fit,
    ModelTest,
    Quality,
    Verdict,
    ViewQuality,
)
from jaxscan.calibration.result import DepthSigma, Direction, GoodTo, LaserLengths, Lengths, LengthSigma, PriorShare
from jaxscan.geometry import Chessboard, LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.measurement import measure_room
from jaxscan.observation import BoardViews, Observations, StripeViews

from .made_room import made_room


CORNER_SIGMA, STRIPE_SIGMA, LEVERAGE = 0.1, 0.15, 0.2


def make_observations(views, points, laser_names, board, random):
    corners = len(board.corners())
    count = len(laser_names) * views
    rows = np.linspace(40, 980, points)
    stripes = np.stack([np.broadcast_to(random.uniform(300, 900, (count, 1)), (count, points)),
                        np.broadcast_to(rows, (count, points))], -1)  # fmt: skip
    return Observations(
        board=board,
        corners=BoardViews(
            q=random.uniform(20, 1000, (views, corners, 2)),
            sigma=np.full((views, corners), CORNER_SIGMA),
            valid=np.ones((views, corners), bool),
            angle=np.where(np.arange(views) < views // 2, 0.0, 0.1 * np.arange(views)),
            placement=np.minimum(np.arange(views), views // 2).astype(np.int32),
            record=np.arange(views, dtype=np.int32) + 100,
        ),
        stripes=StripeViews(
            q=stripes,
            sigma=np.full((count, points), STRIPE_SIGMA),
            valid=np.ones((count, points), bool),
            view=np.repeat(np.arange(views), len(laser_names)).astype(np.int32),
            laser=np.tile(np.arange(len(laser_names)), views).astype(np.int32),
        ),
        width=1280,
        height=1024,
        laser_names=laser_names,
    )


def make_fit(observations, random, unknowns):
    """Residuals as noise of the stated sigmas leaves them, one corner of the second view rejected."""
    views, corners = np.shape(observations.corners.valid)
    stripes = np.shape(observations.stripes.valid)
    left = np.sqrt(1 - LEVERAGE)
    kept = np.ones((views, corners), bool)
    kept[1, 3] = False
    return Fit(
        pose=np.tile(np.eye(4), (views, 1, 1)),
        warp=np.array([1e-4, -2e-4]),
        pitch=0.0,
        corner_error=CORNER_SIGMA * left * random.normal(size=(views, corners, 2)),
        corner_sigma=np.full((views, corners), CORNER_SIGMA),
        corner_leverage=np.full((views, corners, 2), LEVERAGE),
        corner_inlier=kept,
        stripe_error=STRIPE_SIGMA * left * random.normal(size=stripes),
        stripe_sigma=np.full(stripes, STRIPE_SIGMA),
        stripe_leverage=np.full(stripes, LEVERAGE),
        stripe_inlier=np.ones(stripes, bool),
        covariance=np.eye(unknowns),
    )


def make_quality(observations, fit, laser_names):
    rms = np.sqrt(np.mean(np.sum(fit.corner_error**2, -1), axis=1))
    views, corners = fit.corner_inlier.shape
    depths = tuple(DepthSigma(d, 900, d, 0.9 * d, 2 * d) for d in (1.0, 2.5, 4.0))
    lengths = (
        LengthSigma("along the stripe", depth_m=2.5, length_m=0.3, sigma_mm=0.0534),
        LengthSigma("half a turn", depth_m=3.075, length_m=6.1534, sigma_mm=1.62),
    )
    tests = tuple(
        ModelTest(name, statistic=100.0, dof=98, p=0.4, p_structure=0.3)
        for name in ("lens", "board", "paper", "table", "axis", "sheet", "halves", "regions", "lines")
    )
    return Quality(
        converged=True,
        corner_rms_px=0.14,
        corner_rms_all_px=0.15,
        stripe_rms_px=0.15,
        corner_rms_whitened=1.01,
        stripe_rms_whitened=1.6,
        views=views,
        corners=views * corners,
        corners_rejected=1,
        stripe_points=int(fit.stripe_inlier.size),
        stripe_points_rejected=0,
        placements=views // 2 + 1,
        per_view=tuple(
            ViewQuality(
                record=100 + view,
                corners=corners,
                corners_rejected=int((~fit.corner_inlier[view]).sum()),
                corner_rms_px=float(rms[view]),
                stripe_points=10,
                stripe_rms_px=0.15,
                board_z_m=1.2,
            )
            for view in range(views)
        ),
        condition=1e5,
        prior_share=PriorShare(cost=0.001, information=0.9),
        board_warp_m=(1e-4, -2e-4),
        board_warp_sigma_m=(1e-5, 2e-5),
        warnings=("the lamp was on",),
        verdict=Verdict(
            True,
            GoodTo(sigma_mm=0.8, statistical_mm=0.8, at_m=2.5, sigma_px=0.1, statistical_px=0.1),
            tests=tests,
            advice=("Capture the board in the corners of the image.",),
        ),
        spectrum=(Direction(0.97, {"c2": 0.9, "s1": -0.4}), Direction(0.01, {"fx": 0.7, "fy": 0.7})),
        lengths=Lengths(tuple(LaserLengths(name, depths, lengths) for name in laser_names)),
    )


def make_calibration(*, views=6, points=40, laser_names=("red", "green"), board=None):
    random = np.random.default_rng(8)
    board = Chessboard(5, 4, 0.03) if board is None else board
    camera = Pinhole(
        fx=np.asarray(1201.25),
        fy=np.asarray(1202.0),
        cx=np.asarray(640.0),
        cy=np.asarray(511.0),
        distortion=np.array([-0.1, 0.06, 1e-4, 2e-4, 0.0]),
        width=1280,
        height=1024,
    )
    sheets = [LaserSheet.from_plane(np.array([0.99, -0.01, 0.14]), 0.2 + 0.01 * k) for k in range(len(laser_names))]
    table = Turntable.from_axis(np.array([0.01, -0.9999, 0.012]), np.array([0.02, 0.0, -0.15]))
    scanner = Scanner(camera, stack_lasers(sheets), table, laser_names=laser_names)
    order = scanner.parameter_names()
    factor = random.normal(size=(len(order), len(order)))
    sigma = np.array([{"f": 0.4, "c": 0.4}.get(name[0], 1e-4) for name in order])
    covariance = factor @ factor.T
    covariance = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))) * np.outer(sigma, sigma)
    held = [order.index(name) for name in order if name.endswith(("b2", "b3"))]
    covariance[held], covariance[:, held] = 0.0, 0.0
    scanner = dataclasses.replace(scanner, covariance=covariance)
    observations = make_observations(views, points, laser_names, board, random)
    fit = make_fit(observations, random, len(order) + 3)
    return Calibration(
        camera=camera,
        scanner=scanner,
        order=order,
        covariance=covariance,
        quality=make_quality(observations, fit, laser_names),
        observations=observations,
        provenance={"captures": [{"name": "boards", "digest": "sha256:00"}], "versions": {"jaxscan": "0.1.0"}},
        fit=fit,
    )


@pytest.fixture(scope="session")
def made():
    """Makes a calibration; see `make_calibration`."""
    return make_calibration


@pytest.fixture(scope="session")
def calibration():
    """One to look at; do not change it."""
    return make_calibration()


@pytest.fixture(scope="session")
def cloud():
    """A made-up room."""
    return made_room()


@pytest.fixture(scope="session")
def box(cloud):
    return measure_room(cloud)
