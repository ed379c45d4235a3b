"""The rig on a desk: firmware in a simulator, a camera on loopback."""

from bench.errors import BenchError
from bench.rig import CLOCK_HZ, RigOptions, SimulatedRig
