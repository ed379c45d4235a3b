"""The public verbs: they join the core with files, OpenCV and the simulation."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.api.calibration import calibrate, observe_boards, plan_calibration
    from jaxscan.api.drawings import (
        BoardSheets,
        check_drawing_path,
        check_ifc_path,
        draw_board,
        save_board,
        save_drawing,
        save_ifc,
        write_sheets,
    )
    from jaxscan.api.frames import align_cloud
    from jaxscan.api.meshes import Texture, draw_texture, mesh_cloud, poisson_mesh, textured_mesh
    from jaxscan.api.photographs import (
        began,
        check_panorama_path,
        colour_cloud,
        draw_panorama,
        export_photographs,
        has_photographs,
        open_photographs,
        panorama_paths,
        photograph_notes,
        save_panorama,
        save_scan,
    )
    from jaxscan.api.recalibration import recalibrate, register, save_recalibrated_cloud
    from jaxscan.api.reports import board_photographs
    from jaxscan.api.simulation import load_simulation, save_designed_rig, simulate
    from jaxscan.api.sweeps import Reconstruction, reconstruct_capture
    from jaxscan.calibration import Calibration
    from jaxscan.files import (
        load_board,
        load_calibration,
        load_cloud,
        load_scanner,
        load_toml,
        open_capture,
        save_calibration,
        save_cloud,
    )
    from jaxscan.files.clouds import read_cloud
    from jaxscan.files.meshes import check_mesh_path, mesh_paths, save_mesh
    from jaxscan.files.simulated import SimulatedCaptures, simulation_digest
    from jaxscan.measurement import compare_clouds, measure_distance, measure_plane, measure_room
    from jaxscan.recalibration import Recalibration, RecalibrationSettings
    from jaxscan.reconstruction import PointCloud, ReconstructSettings, reconstruct
    from jaxscan.simulation import SimulationConfig
    from jaxscan.stripes import StripeSettings, extract_stripes
    from jaxscan.surface import Mesh, MeshSettings, simplify_mesh
else:
    load_on_use(__name__)
