"""A known world to frames."""

from jaxscan.simulation.rig import make_rig as make_rig
from jaxscan.simulation.scene.scene import make_scene as make_scene
from jaxscan.simulation.sensor import expose as expose
from jaxscan.simulation.spec import BoardsSpec as BoardsSpec
from jaxscan.simulation.spec import CameraSpec as CameraSpec
from jaxscan.simulation.spec import LaserSpec as LaserSpec
from jaxscan.simulation.spec import LightSpec as LightSpec
from jaxscan.simulation.spec import ObjectSpec as ObjectSpec
from jaxscan.simulation.spec import PlanSpec as PlanSpec
from jaxscan.simulation.spec import RoomSpec as RoomSpec
from jaxscan.simulation.spec import SensorSpec as SensorSpec
from jaxscan.simulation.spec import SimulationConfig as SimulationConfig
from jaxscan.simulation.spec import TurntableSpec as TurntableSpec
from jaxscan.simulation.stripe import RowTruth as RowTruth
from jaxscan.simulation.sweep import ExpectedRecord as ExpectedRecord
from jaxscan.simulation.sweep import RenderedRecord as RenderedRecord
from jaxscan.simulation.sweep import develop as develop
from jaxscan.simulation.sweep import expect_boards as expect_boards
from jaxscan.simulation.sweep import expect_record as expect_record
from jaxscan.simulation.sweep import expect_sweep as expect_sweep
from jaxscan.simulation.sweep import render_boards as render_boards
from jaxscan.simulation.sweep import render_sweep as render_sweep
from jaxscan.simulation.sweep import sweep_angles as sweep_angles
from jaxscan.simulation.sweep import true_cloud as true_cloud
from jaxscan.simulation.truth import true_scanner as true_scanner
from jaxscan.simulation.truth import truth as truth
