"""Acceptance tests of the whole scanner: spheres, dumb-bells, plates and lengths across the room.

The rig stands in an empty hall of 7.2 x 7.2 m, and one turn looks at 36 spheres and 6 plates; frames are taken where
targets stand. An operator knows the places of the spheres to within a hand's breadth, and cuts the plates out of the
cloud where they stand. All goes through the whole chain: calibration by our own protocol, rendered frames, stripes,
cloud, fits. The same frames serve all calibrations; form and size are those of the first.

- Probing, after ISO 10360-13 (and VDI/VDE 2634 part 2, section on probing errors): P_Form.Sph.D95, the narrowest shell
  round the fitted sphere that holds 95 % of the points, and P_Size.Sph, the fitted diameter minus the calibrated one.
  Sphere fitted by weighted least squares of free diameter, without outliers; the shell counts them, to a fifth of the
  diameter from the surface. Differences: the sphere is seen once, within a cap of 60 degrees, and not from several
  views; its diameter of 100 to 150 mm is about a fiftieth of the measuring volume's diagonal, where VDI/VDE 2634 asks
  for a tenth to a fifth.
- Sphere spacing SD, after VDI/VDE 2634 parts 2 and 3: centre distance of a dumb-bell minus its calibrated one, in seven
  poses. Difference: the bar has 0.5 m, less than three tenths of the measuring volume's diagonal, because the field of
  the camera is 1.3 m high at 2.5 m. Spheres are fitted with their calibrated diameter.
- Flat form, after ISO 10360-13: E_Form.Pla.D95, the narrowest band between two planes parallel to the fitted plane that
  holds 95 % of the points of a plate of 0.5 x 1 m, in six poses 2.5 m away. The outermost 40 mm are not used, and no
  point that is more than 50 mm from the plate.
- Lengths after ASTM E3125 (point to point, derived points): from sphere to sphere, level, upright and along both
  diagonals, at azimuths 0, 90, 180 and 270 degrees. Differences: upright lengths have 0.84 and 1.16 m, and diagonals
  rise by 11 degrees only, as far as the vertical field of 32 degrees allows; there is no two-face test, because one
  camera with one laser sees each point once; and lengths run across 180 degrees, where the standard's lie before the
  instrument, because the axis and the table's angles show there and nowhere else.

Errors are against the lengths as built; the standards take a reference with an uncertainty of a quarter of the limit.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.beyond.aiming import Part, aim
from experiments.paper.beyond.pictures import draw_hall
from experiments.paper.beyond.spheres import Fit, band95, distance, fit_sphere, together
from experiments.paper.beyond.targets import Hall, Plate, hall_config, make_hall
from experiments.paper.metrics import Metric
from experiments.paper.products.draws import our_calibrations
from experiments.paper.rendering.sweeps import RenderedSweep
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from experiments.recalibration.limits import rms
from jaxscan.measurement.samples import Samples, samples_of
from jaxscan.simulation import RenderedRecord, make_scene, render_sweep


_STEPS = {"kind": (0.5, 2), "unkind": (0.5, 4)}
"""Steps of the table where spheres are [deg], and every how many are taken where plates are."""
_QUICK_STEPS = (0.75, None)
_SETTINGS = jaxscan.ReconstructSettings(min_range_m=0.5, max_range_m=5.2, normals=False, chunk_records=16)
_SECTOR_DEG, _BESIDE_DEG = 10.0, 18.0
"""Records are rendered by sectors, with the targets in them and so far beside them."""
_HAND = 0.04
"""Largest error of the places that the operator gives, in each coordinate [m]."""
_EDGE, _BESIDE = 0.04, 0.05
"""Of a plate: the width of its edge, which is left out, and the largest distance of its points from it [m]."""
_NEAR = 2.55
"""Largest distance from the axis of the targets that have limits [m]."""
_GROUPS = {"bar": "dumb-bells of 0.5 m", "front": "vertical lengths", "across": "lengths across 180 degrees"}
"""Kinds of lengths."""


class Tested(NamedTuple):
    """Results of one calibration."""

    known: dict[str, Fit]
    """Spheres that were found, fitted with their calibrated diameter."""
    free: dict[str, Fit]
    """The same, fitted with a free diameter."""
    flatness: dict[str, float]
    """E_Form.Pla.D95 of each plate [m]."""
    error: np.ndarray
    """Of each of the hall's lengths [m]; NaN where a sphere was not found."""
    sigma: np.ndarray
    """Predicted [m]."""
    whitened: np.ndarray
    """Errors of lengths made independent and of unit variance by their predicted covariance."""


def run(stage: Stage) -> list[Metric]:
    """Scan the hall once; every calibration of our protocol then makes a cloud of the same stripes."""
    hall = make_hall(quick=stage.quick)
    scanners = [jaxscan.load_scanner(path) for path in our_calibrations(stage)]
    clouds = _scan(stage, hall, scanners)
    tests = [_test(stage, hall, scanner, samples) for scanner, samples in zip(scanners, clouds, strict=True)]
    draw_hall(stage, hall, tests)
    return _metrics(hall, tests, limits=not stage.quick)


class _HallSweep(RenderedSweep):
    """Of each sector only the targets around it are in the scene: their fine meshes take time."""

    hall: Hall

    def _records(self) -> Iterator[RenderedRecord]:
        sector = np.rad2deg(self.angles) // _SECTOR_DEG
        for number in np.unique(sector):
            around = self.hall.around((number + 0.5) * _SECTOR_DEG, _SECTOR_DEG / 2 + _BESIDE_DEG)
            scene, angles = make_scene(self.config, extras=around.build), self.angles[sector == number]
            yield from render_sweep(self.config, seed=self.seed + 1000 * int(number), angles=angles, scene=scene)


def _scan(stage: Stage, hall: Hall, scanners: list[jaxscan.Scanner]) -> list[Samples]:
    """The points of all parts of the scan, by each calibration."""
    config = hall_config(stage.config)
    parts = aim(hall, scanners[0], *(_QUICK_STEPS if stage.quick else _STEPS[stage.world]))
    clouds: list[list[Samples]] = [[] for _ in scanners]
    for number, part in enumerate(parts):
        window = windowed(config, part.first, part.stop)
        sweep = _HallSweep(window, part.angles, seed=config.seed + 40 + number)
        sweep.hall = hall
        stripes = jaxscan.extract(sweep, _cut(scanners[0], part), settings=_SETTINGS).stripes
        stage.say(f"acceptance: {len(sweep)} records of {part.stop - part.first} columns")
        for cloud, scanner in zip(clouds, scanners, strict=True):
            points = jaxscan.reconstruct(sweep, _cut(scanner, part), stripes=stripes, settings=_SETTINGS)
            samples = samples_of(points)
            # Profiles of different parts are different profiles.
            cloud.append(samples._replace(profile=samples.profile + 10_000 * number))
    return [Samples.joined(cloud) for cloud in clouds]


def _cut(scanner: jaxscan.Scanner, part: Part) -> jaxscan.Scanner:
    return windowed_scanner(scanner, part.first, part.stop)


def _test(stage: Stage, hall: Hall, scanner: jaxscan.Scanner, samples: Samples) -> Tested:
    hand = stage.generator(41)
    known, free = {}, {}
    for name, ball in hall.balls.items():
        click = np.array(ball.centre) + hand.uniform(-_HAND, _HAND, 3)
        try:
            fits = [fit_sphere(samples, click, ball.diameter, scanner, free=each) for each in (False, True)]
        except ValueError as error:
            stage.say(f"acceptance: {name} is not found: {error}")
            continue
        known[name], free[name] = fits
    flatness = {plate.name: band95(_flat(samples, plate)) for plate in hall.plates}
    there = [{length.first, length.second} <= known.keys() for length in hall.lengths]
    lengths = [length for length, each in zip(hall.lengths, there, strict=True) if each]
    error, sigma = np.full((2, len(hall.lengths)), np.nan)
    pairs = [(length.first, length.second) for length in lengths]
    measured = [distance(known[first], known[second], scanner) for first, second in pairs]
    error[there] = [one.value - hall.true_length(length) for one, length in zip(measured, lengths, strict=True)]
    sigma[there] = [one.sigma for one in measured]
    lower = np.linalg.cholesky(together(known, pairs, scanner))
    return Tested(known, free, flatness, error, sigma, np.linalg.solve(lower, error[there]))


def _flat(samples: Samples, plate: Plate) -> np.ndarray:
    """Distances of a plate's points from their plane by least squares [n], m; no outlier is left out."""
    length = np.linalg.norm(plate.edges, axis=1)
    axes = plate.edges / length[:, None]
    apart = samples.p - plate.centre
    inside = np.all(np.abs(apart @ axes.T) < length / 2 - _EDGE, 1)
    p = samples.p[inside & (np.abs(apart @ np.cross(*axes)) < _BESIDE)]
    middle = p.mean(0)
    return (p - middle) @ np.linalg.svd(p - middle, full_matrices=False)[2][2]


def _metrics(hall: Hall, tests: list[Tested], *, limits: bool) -> list[Metric]:
    found = tests[0].free
    near = [name for name in found if np.linalg.norm(hall.balls[name].centre) < _NEAR]
    far = [name for name in found if name not in near]
    groups = {test: [one.test == test for one in hall.lengths] for test in _GROUPS}
    error = {test: 1e3 * np.concatenate([_known(one.error[part]) for one in tests]) for test, part in groups.items()}
    sigma = {test: 1e3 * np.concatenate([_known(one.sigma[part]) for one in tests]) for test, part in groups.items()}
    form = {name: 1e3 * band95(fit.residual) for name, fit in found.items()}
    size = {name: 2e3 * fit.radius - 1e3 * hall.balls[name].diameter for name, fit in found.items()}
    flat = 1e3 * np.array(list(tests[0].flatness.values()))
    whitened = np.concatenate([one.whitened for one in tests])

    def figure(key: str, value: float, tolerance: float, label: str, high: float | None = None) -> Metric:
        # The limits are for full images.
        return Metric(key, float(value), "mm", "less", tolerance, high=high if limits else None, label=label)

    poses = sum(one.test == "bar" for one in hall.lengths)
    bars, plates = "dumb-bells of 0.5 m, sphere spacing error SD", "plates at 2.5 m, flat form E_Form.Pla.D95"
    many, near_by = f"{poses} poses, {len(tests)} calibrations", "spheres within 2.5 m"
    across = "lengths of 4 to 6 m across 180 degrees"
    out = [
        figure("sphere_spacing_worst", np.abs(error["bar"]).max(), 0.2, f"{bars}: largest of {many}", 0.5),
        figure("sphere_spacing_rms", rms(error["bar"]), 0.1, f"{bars}: rms of {many}"),
        figure("probing_form_worst", max(form[name] for name in near), 0.6, f"{near_by}, P_Form.Sph.D95: largest", 4.5),
        figure(
            "probing_form_far", max([form[name] for name in far]), 1.0, "spheres at 2.9 to 4 m, P_Form.Sph.D95: largest"
        ),
        figure("probing_size_rms", rms([size[name] for name in near]), 0.2, f"{near_by}, P_Size.Sph: rms"),
        figure("flat_form_worst", flat.max(), 0.6, f"{plates}: largest", 4.5),
        figure("flat_form_mean", flat.mean(), 0.3, f"{plates}: mean"),
        figure(
            "upright_rms", rms(error["front"]), 0.15, "vertical lengths of 0.8 and 1.2 m between spheres: rms error"
        ),
        figure("across_rms", rms(error["across"]), 0.3, f"{across}: rms error", 1.0),
        figure("across_worst", np.abs(error["across"]).max(), 0.5, f"{across}: largest error"),
        figure("across_predicted", rms(sigma["across"]), 0.1, f"{across}: predicted standard deviation"),
    ]
    share = 100 * len(found) / len(hall.balls)
    lowest = 100.0 if limits else None
    label = "spheres that are found near the places given"
    out.append(Metric("spheres_found", share, "%", "more", low=lowest, label=label))
    ratios = [("all", "all lengths between spheres, decorrelated", whitened)]
    ratios += [(test, _GROUPS[test], error[test] / sigma[test]) for test in groups]
    for test, words, each in ratios:
        label = f"{words}: rms of error over predicted standard deviation"
        out.append(Metric(f"observed_over_predicted_{test}", rms(each), "1", "near", 0.4, label=label))
    return out


def _known(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]
