"""The rigs that come with the package, and the error without embreex."""

import pathlib
import sys
import tomllib
from importlib import resources

import numpy as np
import pytest

from jaxscan.errors import DependencyError
from jaxscan.simulation import SimulationConfig, make_rig, make_scene, true_scanner, truth
from jaxscan.simulation.scene import Caster
from jaxscan.simulation.sweep import plan_boards


CONFIGS = pathlib.Path(__file__).parents[2] / "configs"
TEXTS = {name: (CONFIGS / f"{name}.toml").read_text() for name in ("paper", "reference", "desk", "fisheye", "unkind")}
TEXTS["demo"] = resources.files("jaxscan").joinpath("data/demo.toml").read_text()


def small(name: str) -> SimulationConfig:
    """The rig with an eighth of its pixels each way, so that its ray table is made in no time."""
    config = SimulationConfig.model_validate(tomllib.loads(TEXTS[name]))
    camera = config.camera
    cx, cy = camera.centre()
    shrunk = camera.model_copy(
        update={
            "width": camera.width // 8,
            "height": camera.height // 8,
            "fx": camera.fx / 8,
            "fy": camera.fy / 8,
            "cx": (cx + 0.5) / 8 - 0.5,
            "cy": (cy + 0.5) / 8 - 0.5,
        }
    )
    return config.model_copy(update={"camera": shrunk})


@pytest.mark.parametrize(
    ("name", "views"),
    # The paper's thirty views are drawn from thousands that do not fit; eight show that views do.
    [(name, 8) for name in TEXTS] + [pytest.param("paper", 30, marks=pytest.mark.slow)],
)
def test_the_rigs_that_come_along_can_be_built_and_calibrated(name, views):
    config = small(name)
    boards = config.boards.model_copy(update={"free_views": min(views, config.boards.free_views)})
    config = config.model_copy(update={"boards": boards})
    assert set(truth(config)["parameters"]) == set(true_scanner(config).parameter_names())
    rig, scene = make_rig(config), make_scene(config, boards=True)
    # Fewer pixels make the margin at the image's border wider: a pose found here exists at full size.
    plan = plan_boards(rig, scene, np.random.default_rng(config.seed))
    assert len(plan) == config.boards.free_views + config.boards.placements
    turned = [placement for placement in plan if placement.number is not None]
    assert all(len(placement.angles) == config.boards.angles for placement in turned)


def test_the_paper_s_rig_is_the_paper_s():
    config = SimulationConfig.model_validate(tomllib.loads(TEXTS["paper"]))
    scanner = true_scanner(config)
    # DESIGN's table: pixel (1200, 800) without distortion on the laser plane, camera frame.
    ray = np.array([(1200 - 1016.814) / 2894.462, (800 - 817.261) / 2887.338, 1.0])
    point = ray * scanner.laser(0).distance / (scanner.laser(0).normal @ ray)
    np.testing.assert_allclose(point, (0.155163, -0.014657, 2.451674), atol=1e-6)
    assert config.plan.steps == 3600 and config.boards.free_views == 30


def test_without_embreex_the_message_says_what_to_install(monkeypatch):
    triangle = np.eye(3)[None]
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(DependencyError, match=r'pip install "jaxscan\[simulate\]"'):
        Caster(triangle)
    monkeypatch.undo()
    far, hit = Caster(triangle).nearest(np.zeros(3), np.array([[1.0, 1, 1], [-1, -1, -1]]))
    np.testing.assert_allclose(far, [1 / 3, np.inf], rtol=1e-6)
    assert hit.tolist() == [0, -1]
