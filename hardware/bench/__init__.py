"""The rig on a desk: firmware in a simulator, a camera on loopback."""

from bench.errors import BenchError as BenchError
from bench.rig import CLOCK_HZ as CLOCK_HZ
from bench.rig import RigOptions as RigOptions
from bench.rig import SimulatedRig as SimulatedRig
