"""Renders frames of a known world, with their truth."""

from jaxscan.simulation.boards import SeenBoard, make_print
from jaxscan.simulation.camera import expose
from jaxscan.simulation.light import RowTruth
from jaxscan.simulation.planning import Placement, plan_boards
from jaxscan.simulation.rays import distort, undistort
from jaxscan.simulation.rig import Motion, TrueRig, make_rig, rodrigues, turning_axis
from jaxscan.simulation.scene import make_scene
from jaxscan.simulation.settings import (
    BoardsSpec,
    CameraSpec,
    LaserSpec,
    LightSpec,
    ObjectSpec,
    PlanSpec,
    RoomSpec,
    SensorSpec,
    SimulationConfig,
    TurntableSpec,
)
from jaxscan.simulation.sweep import (
    ExpectedRecord,
    RenderedRecord,
    board_pairs,
    develop,
    expect_boards,
    expect_record,
    expect_sweep,
    render_boards,
    render_sweep,
    speckled,
    sweep_angles,
    true_cloud,
)
from jaxscan.simulation.truth import true_scanner, truth
