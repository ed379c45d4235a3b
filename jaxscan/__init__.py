"""A camera, a line laser and a turntable as a precise 3D scanner for rooms: the public names and their modules.

`import jaxscan` loads nothing, so that the command line hears a signal from its first milliseconds on.
"""

from jaxscan.facades import TYPE_CHECKING, load_on_use


__version__ = "0.1.0"

if TYPE_CHECKING:
    from jaxscan.api import (
        Reconstruction,
        align_cloud,
        calibrate,
        colour_cloud,
        draw_panorama,
        export_photographs,
        load_simulation,
        mesh_cloud,
        observe_boards,
        recalibrate,
        reconstruct_capture,
        save_board,
        save_designed_rig,
        save_drawing,
        save_ifc,
        save_mesh,
        save_panorama,
        save_scan,
        simulate,
    )
    from jaxscan.calibration import (
        Calibration,
        CalibrationSettings,
        KnownParts,
        Quality,
        Verdict,
        calibrate_observations,
    )
    from jaxscan.design import RigChoice, RigDesign, RigWish, Sensor, design_rig
    from jaxscan.drawing import Drawing, Sheet, Survey, draw_orthophotos, draw_plan, draw_section, survey_room
    from jaxscan.errors import (
        CalibrationError,
        CaptureError,
        CloudError,
        ConfigError,
        DependencyError,
        JaxscanError,
        MeasurementError,
        OptionError,
    )
    from jaxscan.files import (
        Capture,
        CaptureHeader,
        create_capture,
        load_board,
        load_calibration,
        load_cloud,
        load_scanner,
        open_capture,
        save_calibration,
        save_cloud,
        save_scanner,
    )
    from jaxscan.geometry import (
        Charuco,
        Chessboard,
        DoubleSphere,
        Fisheye,
        LaserSheet,
        LinearStage,
        Pinhole,
        Rig,
        Scanner,
        Still,
        Turntable,
        fit_axis,
        fit_plane,
        pixels,
        plane_sigma,
        points,
        rays,
        slopes,
    )
    from jaxscan.measurement import (
        Estimate,
        RoomFrame,
        RoomOutline,
        TargetFrame,
        align_room,
        align_targets,
        compare_clouds,
        measure_deviations,
        measure_distance,
        measure_outline,
        measure_plane,
        measure_points,
        measure_room,
        measure_sphere,
    )
    from jaxscan.observation import BoardViews, Observations, StripeViews
    from jaxscan.photographs import BlendSettings, Panorama, Photograph, Photographs, colour_points, make_occluder
    from jaxscan.recalibration import Given, MeasuredLength, Recalibration, RecalibrationSettings
    from jaxscan.reconstruction import Extraction, PointCloud, ReconstructSettings, Sweep, extract, reconstruct
    from jaxscan.simulation import SimulationConfig
    from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, Stripes, StripeSettings, extract_stripes
    from jaxscan.surface import Mesh, MeshSettings, simplify_mesh
else:
    load_on_use(__name__, "__version__")
