"""Clouds of the room by our calibrations and by the paper's method, and its dimensions in them."""

from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.paper.methods.paper_way import PaperWay, cloud
from experiments.paper.products.room import PlainStripes, Room, room_sweep
from experiments.paper.stage import Stage
from jaxscan import recalibration
from jaxscan.measurement.room import RoomBox
from jaxscan.reconstruction import plan_sweep, smooth_stripes


PROFILES, ROWS = 360, 200
"""Of a thinned cloud, about: enough points for planes, and thirty clouds take little time."""
UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the camera's frame (right, down, ahead) to one whose z is up."""
_SIGMA_M, _SIGMA_AT_M = 1e-3, 1.3
FARTHEST_M = 10.0
"""Points farther away than this are left out: no room is so long, and plain finders take reflections too."""


class Points(NamedTuple):
    """A cloud as `jaxscan.measure_room` takes it."""

    xyz: np.ndarray
    """[records, rows, 3], m; z up, zero where not valid."""
    sigma_random: np.ndarray
    valid: np.ndarray
    laser: np.ndarray
    angle: np.ndarray


class Size(NamedTuple):
    """Both horizontal dimensions of a room, from the cloud [mm]."""

    width: float
    length: float
    width_sigma: float = np.nan
    """Predicted standard deviation."""
    length_sigma: float = np.nan

    def errors(self, truth: "Size") -> np.ndarray:
        """Of width and length [2]."""
        return np.array(self[:2]) - np.array(truth[:2])

    def sigmas(self) -> np.ndarray:
        """Of width and length [2]."""
        return np.array(self[2:])


NOT_MEASURED = Size(np.nan, np.nan)


def true_size(stage: Stage) -> Size:
    """Of the configuration's room."""
    room = stage.config.room
    assert room is not None
    width, length = sorted(1e3 * side for side in room.size_m[:2])
    return Size(width, length)


def box_of(points: Points | jaxscan.PointCloud, scanner: jaxscan.Scanner | None = None) -> RoomBox | None:
    """Walls by planes; None where no two pairs of opposite walls are found."""
    try:
        box = jaxscan.measure_room(points, scanner=scanner)
    except jaxscan.MeasurementError:
        return None
    return None if box.width is None or box.length is None else box


def size_of(box: RoomBox | None) -> Size:
    """Wall to wall; NaN where they were not found."""
    if box is None or box.width is None or box.length is None:
        return NOT_MEASURED
    sides = box.width, box.length
    return Size(*(1e3 * side.value_m for side in sides), *(1e3 * side.sigma_m for side in sides))


def thinned(room: Room) -> Room:
    """Every n-th record, so that about `PROFILES` are left; rows are all there."""
    step = max(1, len(room.angles) // PROFILES)
    return Room(records_of(room.stripes, step), {}, room.angles[::step], room.window)


def records_of(stripes: jaxscan.Stripes, step: int) -> jaxscan.Stripes:
    """Every n-th record of stripes of one laser."""
    fields = {name: np.asarray(field)[::step] for name, field in vars(stripes).items() if field is not None}
    return jaxscan.Stripes(**fields | {"record": np.arange(len(fields["u"]), dtype=np.int32)})


def our_cloud(stage: Stage, room: Room, scanner: jaxscan.Scanner, *, normals: bool = False) -> jaxscan.PointCloud:
    """The room by one of our calibrations; no frame is read."""
    settings = jaxscan.ReconstructSettings(normals=normals)
    return jaxscan.reconstruct(room_sweep(stage, room.angles), scanner, stripes=room.stripes, settings=settings)


def recalibrated(stage: Stage, room: Room, path: str) -> jaxscan.Recalibration:
    """A calibration from boards, refined by the walls of the sweep itself.

    Features of the laser-off images could help too; here the stripes serve alone.
    """
    stored = jaxscan.load_calibration(path)
    plan = plan_sweep(room_sweep(stage, room.angles), stored.scanner, jaxscan.ReconstructSettings())
    along = smooth_stripes(plan.sweep, room.stripes)
    sweep = recalibration.SweepStripes(
        name="room",
        centre=along.u,
        sigma=along.sigma,
        shared_lines=along.shared_lines,
        valid=np.asarray(room.stripes.valid) & (along.sigma > 0),
        record=np.asarray(room.stripes.record),
        laser=plan.sheet,
        angle=room.angles,
        stripe_axis=plan.stripe_axis,
    )
    return recalibration.recalibrate([sweep], stored)


def paper_points(way: PaperWay, plain: PlainStripes, angles: np.ndarray) -> Points:
    """The room by a calibration of the paper's method, thinned."""
    records, rows = (max(1, count // wanted) for count, wanted in zip(plain.u.shape, (PROFILES, ROWS), strict=True))
    # Rows are masked, not cut out: their number is their place in the image.
    some = np.zeros(plain.u.shape[1], bool)
    some[::rows] = True
    xyz = cloud(way, plain.u[::records], plain.valid[::records] & some, angles[::records])[:, some]
    return points_of(xyz @ UPRIGHT.T, angles[::records])


def points_of(xyz: np.ndarray, angles: np.ndarray) -> Points:
    """A cloud by a method that states no uncertainty of a point: one that grows with the square of the distance.

    Args:
        xyz: [records, rows, 3], m; z up, NaN where there is no point.
        angles: Of the table [records], rad.
    """
    far = np.linalg.norm(xyz, axis=-1)
    valid = np.isfinite(far) & (far < FARTHEST_M)
    sigma = np.where(valid, _SIGMA_M * (far / _SIGMA_AT_M) ** 2, 0.0)
    lasers = np.zeros(len(xyz), np.uint8)
    return Points(np.where(valid[..., None], xyz, 0.0), sigma, valid, lasers, np.asarray(angles))
