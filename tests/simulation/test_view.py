"""The scene by tiles: as if a ray had been cast for every pixel."""

import numpy as np
import pytest

import jaxscan.simulation.view as view
from jaxscan.simulation import SimulationConfig
from jaxscan.simulation.camera import channels
from jaxscan.simulation.rig import make_rig
from jaxscan.simulation.scene import Material, make_scene


PINHOLE = {"width": 331, "height": 250, "fx": 300.0, "fy": 300.0, "k1": -0.1}
FISHEYE = {"model": "fisheye", "width": 331, "height": 250, "fx": 100.0, "fy": 100.0, "field_deg": 180.0}
GREY = Material(((0.5, 0.5, 0.5),))


def thin_things(mesh):
    """Thinner than a pixel, and far smaller than a tile."""
    for at in np.linspace(0.3, 3.9, 13):
        mesh.cylinder((float(at), 2.6 + 2.0 * float(np.sin(7 * at)), 0.0), 0.002, 2.4, GREY)
        mesh.sphere((float(at), 1.0, 0.4 + 0.4 * float(at)), 0.006, GREY)


def seen(config, phi, monkeypatch, *, every):
    rig, scene = make_rig(config), make_scene(config, extras=thin_things)
    if every:
        monkeypatch.setattr(view, "plain_tiles", lambda rig, tiles, scene, pose: np.full(len(tiles.rays.x), -1))
    found = view.observe(rig, scene, rig.pose(phi), channels(config.sensor))
    monkeypatch.undo()
    return found


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
@pytest.mark.parametrize("phi", [0.0, 1.1, 2.3, 4.0])
def test_nothing_is_lost_between_the_corners_of_tiles(camera, phi, monkeypatch):
    config = SimulationConfig.model_validate({"camera": camera, "room": {}})
    tiles, rays = (seen(config, phi, monkeypatch, every=every) for every in (False, True))
    rig = make_rig(config)
    plain = view.plain_tiles(
        rig, view.tiles_of(rig.config.camera), make_scene(config, extras=thin_things), rig.pose(phi)
    )
    assert np.mean(plain >= 0) > 0.2
    surface = make_scene(config, extras=thin_things).surface
    other = surface[tiles.triangle] != surface[rays.triangle]
    # Rays that meet an edge may see either side of it.
    assert other.mean() < 2e-5
    assert np.abs(tiles.depth / rays.depth - 1)[~other].max() < 1e-5
    light = np.abs(tiles.ambient - rays.ambient)
    assert np.mean(light > 1e-4) < 5e-4
