"""Renders frames of a known world, with their truth."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.simulation.boards import SeenBoard, make_print
    from jaxscan.simulation.camera import expose
    from jaxscan.simulation.light import RowTruth
    from jaxscan.simulation.rig import Motion, TrueRig, distort, make_rig, rodrigues, turning_axis, undistort
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
        ExpectedRecord,
        Placement,
        RenderedRecord,
        board_pairs,
        develop,
        expect_record,
        expect_sweep,
        plan_boards,
        render_boards,
        render_sweep,
        speckled,
        sweep_angles,
        take_frame,
        true_cloud,
        true_scanner,
        truth,
    )
else:
    load_on_use(__name__)
