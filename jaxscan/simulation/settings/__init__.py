"""The configuration of a simulated rig."""

from jaxscan.simulation.settings.boards import BoardsSpec
from jaxscan.simulation.settings.camera import CameraSpec, PixelFormat, SensorSpec
from jaxscan.simulation.settings.config import SimulationConfig
from jaxscan.simulation.settings.laser import Colour, LaserSpec
from jaxscan.simulation.settings.numbers import WIDEST_BLUR_PX
from jaxscan.simulation.settings.surroundings import LightSpec, MirrorSpec, ObjectSpec, RoomSpec
from jaxscan.simulation.settings.table import PlanSpec, TurntableSpec
