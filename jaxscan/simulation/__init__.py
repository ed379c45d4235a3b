"""Renders frames of a known world, with their truth."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.simulation.boards import SeenBoard
    from jaxscan.simulation.camera import expose
    from jaxscan.simulation.light import RowTruth
    from jaxscan.simulation.planning import Placement, plan_boards
    from jaxscan.simulation.printing import make_print
    from jaxscan.simulation.rays import distort, undistort
    from jaxscan.simulation.records import ExpectedRecord, RenderedRecord, develop, expect_record, speckled, take_frame
    from jaxscan.simulation.rig import Motion, TrueRig, make_rig, rodrigues, turning_axis
    from jaxscan.simulation.scene import make_scene
    from jaxscan.simulation.settings import (
        BoardsSpec,
        CameraSpec,
        LaserSpec,
        LightSpec,
        MirrorSpec,
        ObjectSpec,
        PlanSpec,
        RoomSpec,
        SensorSpec,
        SimulationConfig,
        TurntableSpec,
    )
    from jaxscan.simulation.sweep import (
        board_pairs,
        expect_boards,
        expect_sweep,
        render_boards,
        render_sweep,
        sweep_angles,
        true_cloud,
    )
    from jaxscan.simulation.truth import true_scanner, truth
else:
    load_on_use(__name__)
