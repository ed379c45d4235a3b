"""The rig on a desk: firmware in a simulator, a camera on loopback."""

from bench.places import BenchError
from bench.rig import CLOCK_HZ, RigOptions, SimulatedRig
