"""A recalibration made up for drawing: names, numbers and residuals that no solve has seen."""

import dataclasses

import numpy as np

from jaxscan.recalibration import (
    Adjusted,
    Closure,
    Drift,
    Gain,
    HoldOut,
    LengthGain,
    Moved,
    PanoramaOfWalls,
    Recalibration,
    RoomObservations,
    SurfacePoints,
    Surfaces,
    TableFindings,
)


WALL_M = 0.4e-3
BEND_M = 3e-3


def make_panorama(profiles=120, lines=96, *, name="captures/room"):
    """Walls that are bent before and flat after, with a window in which nothing is seen."""
    random = np.random.default_rng(4)
    angle = np.linspace(0, 2 * np.pi, profiles, endpoint=False)
    line = np.linspace(-1, 1, lines)
    bend = BEND_M * np.sin(4 * angle)[:, None] * line[None, :] ** 2
    noise = WALL_M * random.normal(size=(profiles, lines))
    seen = np.ones((profiles, lines), bool)
    seen[20:35, 30:60] = False
    return PanoramaOfWalls(name, bend + noise, noise, seen, angle)


def make_adjusted(scanner, *, stations=1, points=500):
    floats, whole = np.zeros(points), np.zeros(points, np.int64)
    surfaces = Surfaces(np.eye(3)[:2], np.array([1.9, 2.1]), np.zeros((2, 3)))
    observed = RoomObservations(
        SurfacePoints(np.zeros((points, 2)), floats, whole, whole, whole, whole, whole),
        surfaces,
        angles=(np.linspace(0, 6.2, 120),),
        station=np.zeros(1, np.int64),
        stripe_axis="rows",
    )
    poses = np.tile(np.eye(4), (stations, 1, 1))
    poses[1:, 0, 3] = 2.0
    covariance = np.zeros((stations, 6, 6))
    covariance[1:] = 1e-8 * np.eye(6)
    smaller = None if scanner.covariance is None else 0.04 * np.asarray(scanner.covariance)
    return Adjusted(
        scanner=dataclasses.replace(scanner, covariance=smaller),
        prior=scanner,
        departure=np.zeros(len(scanner.parameter_names())),
        stations=poses,
        station_covariance=covariance,
        surfaces=surfaces,
        corrections=(np.zeros(120),),
        point_error=floats,
        point_sigma=floats,
        point_kept=np.ones(points, bool),
        track_kept=np.zeros(0, bool),
        wall_m=WALL_M,
        inflation=2.0,
        observations=observed,
        cost=500.0,
        freedom=480,
        converged=True,
        steps=9,
    )


def make_recalibration(scanner, *, drifted=True, updated=True, stations=1, names=("captures/room",)):
    """Everything that a report can show."""
    adjusted = make_adjusted(scanner, stations=stations)
    drift = Drift(96.0, 20, 1e-9, True, "laser red", "0.050 degrees") if drifted else Drift(20.1, 20, 0.43, False)
    return Recalibration(
        scanner=adjusted.scanner if updated else scanner,
        updated=updated,
        refused="" if updated else "nothing was gained: no direction is known 1.05 times better",
        adjusted=adjusted,
        drift=drift,
        gains=(
            Gain("radial scale", 120.0, 119.0, "ppm"),
            Gain("height scale", 150.0, 150.0, "ppm"),
            Gain("d1", 1.0, 0.4),
            Gain("laser red: n1, fx", 1.0, 0.02),
        ),
        unobserved=("The radial scale is held by the stored calibration alone.",),
        moved=(
            Moved("laser red: n1", 0.01, 0.0109, 1e-4, 2e-5, 9.0),
            Moved("fx", 1201.25, 1201.3, 0.4, 0.1, 0.1),
            Moved("gain", 1.0, 1.0, 0.0, 0.0, 0.0),
        ),
        hold_out=HoldOut((3.1, 2.9), (0.5, 0.6), better=True),
        table=TableFindings(sentences=("the table turns half as far as the journal says",)),
        closure=Closure(4.2, 0.2, 0.05, "overlap"),
        panoramas=tuple(make_panorama(name=name) for name in names),
        notes=("a pair was dark",),
        lengths=(
            LengthGain("red", "along the stripe", 2.5, 0.3, 0.4, 0.05),
            LengthGain("red", "half a turn", 3.075, 6.15, 63.0, 1.1),
        ),
    )
