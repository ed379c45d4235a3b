"""Measurements in clouds: rooms, distances, planes, comparison with a true cloud."""

from jaxscan.measurement.compare import CloudComparison, ErrorStatistics, compare_clouds
from jaxscan.measurement.distances import DistanceMeasurement, measure_distance
from jaxscan.measurement.frames import RoomFrame, TargetFrame, align_room, align_targets
from jaxscan.measurement.planes import PlaneMeasurement, measure_plane
from jaxscan.measurement.room import Dimension, RoomBox, measure_room
