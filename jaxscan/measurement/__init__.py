"""Clouds to numbers."""

from jaxscan.measurement.compare import CloudComparison as CloudComparison
from jaxscan.measurement.compare import ErrorStatistics as ErrorStatistics
from jaxscan.measurement.compare import compare_clouds as compare_clouds
from jaxscan.measurement.distances import DistanceMeasurement as DistanceMeasurement
from jaxscan.measurement.distances import measure_distance as measure_distance
from jaxscan.measurement.planes import PlaneMeasurement as PlaneMeasurement
from jaxscan.measurement.planes import measure_plane as measure_plane
from jaxscan.measurement.room import Dimension as Dimension
from jaxscan.measurement.room import RoomBox as RoomBox
from jaxscan.measurement.room import measure_room as measure_room
