"""Fig. 8: two textured objects, reconstructed without and with colour by a colour camera."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import jaxscan
from experiments.paper.methods import METHODS, in_window, paper_cloud
from experiments.paper.products import RenderedSweep, draws, our_calibrations, plain_stripes
from experiments.paper.stage import Metric, Stage, plt, save, windowed, windowed_scanner
from experiments.paper.targets import GLOBE_M, GLOBE_RADIUS, VASE_M, nominal_window, still_life, studio
from jaxscan.report.clouds import Viewpoint, draw_cloud
from jaxscan.simulation import SimulationConfig, make_rig
from jaxscan.simulation.camera import channels
from jaxscan.simulation.scene import Scene, make_scene
from jaxscan.surface import load_open3d


STEP_DEG = {False: 0.1, True: 0.2}
"""Step of the full and of the quick sweep."""
TURN_DEG = (-11.5, 11.5)
DEPTHS_M = (1.05, 1.70)
"""Between which objects and table lie."""
REACH_M = {False: 0.003, True: 0.006}
"""A place of the surface has points if one lies as near: the profiles are 2.6 and 5.2 mm apart."""
_SEED = 81
_SAMPLES = 20_000


class Truth(NamedTuple):
    """The objects, and the parts of their surfaces that the scanner can see."""

    scene: Scene
    config: SimulationConfig
    places: np.ndarray
    """Places spread evenly over the surfaces that camera and laser both see during the sweep [n, 3], scanner frame."""
    reach: float
    """How near a point must be to one of them [m]."""


def run(stage: Stage) -> list[Metric]:
    """Scan the objects."""
    config = studio(stage.config)
    first, stop = nominal_window(config, *DEPTHS_M)
    config = windowed(config, first, stop)
    scene = make_scene(config, extras=still_life)
    angles = np.deg2rad(np.arange(*TURN_DEG, STEP_DEG[stage.quick]))
    plain, watch = plain_stripes((len(angles), config.camera.height))
    sweep = RenderedSweep(config, angles, seed=_SEED, scene=scene, watch=watch)
    scanner = windowed_scanner(jaxscan.load_scanner(our_calibrations(stage, 3)[0]), first, stop)
    settings = jaxscan.ReconstructSettings(min_range_m=DEPTHS_M[0] - 0.1, max_range_m=DEPTHS_M[1] + 0.1)
    cloud = jaxscan.reconstruct(sweep, scanner, settings=settings)
    stage.say(f"figure 8: {len(angles)} records of two objects")
    truth = Truth(scene, config, visible_places(config, scene, angles), REACH_M[stage.quick])
    metrics = judge("ours", np.asarray(cloud.xyz, np.float64)[np.asarray(cloud.valid)], truth)
    metrics += judge_colours(cloud, truth)
    way = in_window(draws(stage)[0].paper, first)
    xyz = paper_cloud(way, plain["gravity"].u, plain["gravity"].valid, angles)
    pose = make_rig(config).pose(0.0)
    metrics += judge("paper_way", pose.apply(xyz[np.isfinite(xyz).all(-1)]), truth)
    draw_objects(stage.picture("figure_8"), f"Fig. 8, {stage.world} world: a vase and a globe", cloud)
    return metrics


def visible_places(config: SimulationConfig, scene: Scene, angles: np.ndarray) -> np.ndarray:
    """Places of the surface that the sheet crosses during the sweep where camera and laser see it.

    Surfaces at less than about 12 degrees to either ray do not count.

    Args:
        angles: Angle of the table for each record [rad].

    Returns:
        [n, 3], m, scanner frame.
    """
    rig = make_rig(config)
    sheet = rig.sheets[0]
    places, normals = _spread(scene)
    every = [rig.pose(float(phi)) for phi in angles]
    beside = np.stack([pose.inverse().apply(places) @ sheet.normal - sheet.distance for pose in every])
    crossed = (beside[:-1] > 0) != (beside[1:] > 0)
    step = np.argmax(crossed, axis=0)
    seen = crossed.any(0)
    camera, (cx, cy) = config.camera, config.camera.centre()
    for index in np.unique(step[seen]):
        own = np.flatnonzero(seen & (step == index))
        local = every[index].inverse().apply(places[own])
        u, v = (f * local[:, k] / local[:, 2] + c for k, f, c in ((0, camera.fx, cx), (1, camera.fy, cy)))
        ok = (local[:, 2] > 0) & (u > 0) & (u < camera.width - 1) & (v > 0) & (v < camera.height - 1)
        for eye in (every[index].translation, every[index].apply(sheet.origin)):
            leg = eye - places[own]
            ok &= np.sum(leg * normals[own], 1) > 0.2 * np.linalg.norm(leg, axis=1)
            ok &= ~scene.blocked(eye, places[own].astype(np.float32))
        seen[own] = ok
    return places[seen]


def judge(key: str, points: np.ndarray, truth: Truth) -> list[Metric]:
    """Share of the surface that has points, and how far points are from it.

    Args:
        points: [n, 3], m, scanner frame.
    """
    away = _nearest(truth.scene, points)[0] * 1000
    share = float(np.mean(cKDTree(points).query(truth.places)[0] < truth.reach)) * 100
    what = "ours" if key == "ours" else METHODS["gravity"]
    median, most = (float(np.percentile(away, level)) for level in (50, 95))
    far = f"{what}: distance of points from the surface"
    return [
        Metric(f"{key}_share", share, "%", "more", 2, label=f"{what}: share of the visible surface with points"),
        Metric(f"{key}_distance", median, "mm", "less", 0.1, label=f"{far}, median"),
        Metric(f"{key}_distance_95", most, "mm", "less", 0.3, label=f"{far}, 95th percentile"),
    ]


def judge_colours(cloud: jaxscan.PointCloud, truth: Truth) -> list[Metric]:
    """Colours of points against those of the nearest surface in the room's light, without lens, sensor and noise."""
    valid = np.asarray(cloud.valid)
    points = np.asarray(cloud.xyz, np.float64)[valid]
    _, places, triangle = _nearest(truth.scene, points)
    view = make_rig(truth.config).pose(0.0).translation
    weights = channels(truth.config.sensor)
    picture = truth.scene.ambient(triangle[None], places.astype(np.float32)[None], view, weights)[:, 0].T
    error = np.abs(np.asarray(cloud.rgb, np.float64)[valid] - picture * truth.config.light.white_dn)
    median, most = (float(np.percentile(error, level)) for level in (50, 95))
    return [
        Metric("ours_colour", median, "DN", "less", 0.3, label="ours: colour error of points, median"),
        Metric("ours_colour_95", most, "DN", "less", 1.5, label="ours: colour error of points, 95th percentile"),
    ]


def draw_objects(path: Path, title: str, cloud: jaxscan.PointCloud) -> None:
    """The cloud without and with colour, from the scanner's place and from one side of it."""
    valid = np.asarray(cloud.valid)
    xyz, normals = np.asarray(cloud.xyz), np.asarray(cloud.normals)
    # Brighter than the camera saw it, so that white is white.
    rgb = np.asarray(cloud.rgb, np.float32)
    rgb = np.clip(rgb * min(3.0, 240 / max(np.percentile(rgb[valid], 99), 1)), 0, 255).astype(np.uint8)
    # Clay in the light of a lamp at the upper left.
    light = np.abs(normals @ (np.array([-1.0, 0.6, 0.8], np.float32) / np.sqrt(2)))
    clay = (np.array([226, 222, 214]) * np.clip(0.25 + 0.75 * light, 0, 1)[..., None]).astype(np.uint8)
    target = (0.21 + (VASE_M[1] + GLOBE_M[1]) / 2, 0.0, -GLOBE_RADIUS / 2)
    figure, axes = plt.subplots(2, 2, figsize=(12, 11), dpi=110, layout="constrained")
    views = {
        "from the scanner's place": (0.25, 0.0, 0.0),
        "from 25 cm to the left and 20 cm above it": (0.25, 0.25, 0.2),
    }
    for row, (name, eye) in zip(axes, views.items(), strict=True):
        view = Viewpoint(eye, target, fov_deg=35.0, cut_away=False)
        for axis, colours, word in zip(row, (clay, rgb), ("without", "with"), strict=True):
            shown = draw_cloud(np.where(valid[..., None], xyz, 0), colours, size=(640, 580), view=view)
            axis.imshow(shown)
            axis.set_title(f"{word} colour, {name}", fontsize=11)
            axis.set_axis_off()
    figure.suptitle(title, fontsize=13)
    save(figure, path, 110)


def _spread(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Places spread evenly over all but the hall's own six sides, and their normals out of the objects."""
    triangles = np.concatenate(scene.mesh.triangles[6:])
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(triangles), _SAMPLES, p=area / area.sum())
    weight = rng.dirichlet((1, 1, 1), _SAMPLES)
    return np.einsum("nk,nkd->nd", weight, triangles[chosen]), cross[chosen] / area[chosen, None]


def _nearest(scene: Scene, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance from the nearest surface [m], its place, and its triangle."""
    open3d: Any = load_open3d()
    tensor = open3d.core.Tensor.from_numpy
    surface, corners = open3d.t.geometry.RaycastingScene(), np.concatenate(scene.mesh.triangles).astype(np.float32)
    indices = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    surface.add_triangles(tensor(corners.reshape(-1, 3)), tensor(indices))
    found = surface.compute_closest_points(tensor(np.ascontiguousarray(points, np.float32)))
    places = found["points"].numpy().astype(np.float64)
    return np.linalg.norm(points - places, axis=1), places, found["primitive_ids"].numpy().astype(np.int64)
