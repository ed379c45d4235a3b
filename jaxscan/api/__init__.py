"""The public verbs: they join the core with files, OpenCV and the simulation."""

from jaxscan.api.calibration import calibrate, observe_boards, plan_calibration
from jaxscan.api.drawings import save_drawing
from jaxscan.api.recalibration import recalibrate, save_recalibrated_cloud
from jaxscan.api.simulation import load_simulation, simulate
from jaxscan.api.sweeps import Reconstruction, reconstruct_capture
from jaxscan.files import (
    load_calibration,
    load_cloud,
    load_scanner,
    load_toml,
    open_capture,
    save_calibration,
    save_cloud,
)
from jaxscan.files.simulated import SimulatedCaptures, simulation_digest
from jaxscan.measurement import compare_clouds, measure_distance, measure_plane, measure_room
from jaxscan.recalibration import Recalibration, RecalibrationSettings
from jaxscan.reconstruction import PointCloud, ReconstructSettings, reconstruct
from jaxscan.simulation import SimulationConfig
from jaxscan.stripes import StripeSettings, extract_stripes
