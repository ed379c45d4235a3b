"""The public verbs, which join the core and the edges."""

from jaxscan.api.calibration import calibrate, observe_boards
from jaxscan.api.simulation import load_simulation, simulate
from jaxscan.api.sweeps import Reconstruction, reconstruct_capture
from jaxscan.calibration import Calibration, CalibrationSettings
from jaxscan.files import (
    Capture,
    load_calibration,
    load_cloud,
    load_scanner,
    load_toml,
    open_capture,
    save_calibration,
    save_cloud,
)
from jaxscan.files.simulated import SimulatedCaptures, simulation_digest
from jaxscan.geometry import Scanner, fit_axis, fit_plane, plane_sigma
from jaxscan.measurement import compare_clouds, measure_distance, measure_plane, measure_room
from jaxscan.reconstruction import PointCloud, ReconstructSettings, Sweep, extract_sweep, reconstruct
from jaxscan.simulation import SimulationConfig
from jaxscan.stripes import LaserLine, NoiseModel, Stripes, StripeSettings, extract_stripes
