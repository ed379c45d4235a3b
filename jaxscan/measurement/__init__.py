"""Measurements in clouds: rooms, distances, planes, comparison with a true cloud."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.measurement.between import (
        AngleMeasurement,
        DistanceMeasurement,
        HeightMeasurement,
        PointDistance,
        length_words,
        measure_angle,
        measure_distance,
        measure_height,
        measure_points,
    )
    from jaxscan.measurement.clean import in_box, thinned, with_neighbours
    from jaxscan.measurement.compare import CloudComparison, ErrorStatistics, compare_clouds
    from jaxscan.measurement.deviations import DeviationMap, measure_deviations
    from jaxscan.measurement.frames import RoomFrame, TargetFrame, align_room, align_targets
    from jaxscan.measurement.outline import Estimate, Opening, RoomOutline, Side, find_openings, measure_outline
    from jaxscan.measurement.planes import PlaneMeasurement, measure_plane
    from jaxscan.measurement.room import Dimension, RoomBox, measure_room
    from jaxscan.measurement.samples import SIGMA_FLOOR_M, camera_centres
    from jaxscan.measurement.spheres import SphereMeasurement, measure_sphere
else:
    load_on_use(__name__)
