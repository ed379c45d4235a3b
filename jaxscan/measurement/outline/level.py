"""Floor and ceiling, and the frame of the plan that stands on the floor."""

from typing import NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.measurement.planes import Plane
from jaxscan.measurement.room import LEVEL, main_direction
from jaxscan.measurement.samples import Samples
from jaxscan.measurement.walls import BEYOND, Wall, outermost, refine_wall


class Frame(NamedTuple):
    """The frame of a plan: z up from the floor, x along most walls, the origin in the outline's lower left.

    A point p of the cloud is at `rotation` p + `translation` [m].
    """

    rotation: np.ndarray
    translation: np.ndarray

    def of(self, p: np.ndarray) -> np.ndarray:
        """Points of the cloud [..., 3] in the plan, m."""
        return p @ self.rotation.T + self.translation

    def back(self, p: np.ndarray) -> np.ndarray:
        """Points of the plan [..., 3] in the cloud, m."""
        return (p - self.translation) @ self.rotation

    def samples(self, samples: Samples) -> Samples:
        """The points of a cloud in the plan."""
        return samples._replace(p=self.of(samples.p), origin=self.of(samples.origin))

    def wall(self, wall: Wall) -> Wall:
        """A wall of the cloud in the plan."""
        return Wall(self.plane(wall.plane), self.samples(wall.samples), wall.scale)

    def plane(self, plane: Plane) -> Plane:
        """A plane of the cloud in the plan."""
        normal = self.rotation @ plane.normal
        return plane._replace(
            normal=normal,
            distance=float(plane.distance + normal @ self.translation),
            centre=self.of(plane.centre),
            axes=plane.axes @ self.rotation.T,
        )

    def shifted(self, shift: np.ndarray) -> "Frame":
        """The frame whose coordinates are larger by a shift [3], m."""
        return self._replace(translation=self.translation + shift)


def find_level(
    samples: Samples, planes: list[tuple[Plane, np.ndarray]], rng: np.random.Generator
) -> tuple[Frame, Wall, Wall | None, list[str]]:
    """The frame of the plan; floor and ceiling in the cloud's frame; and why a plane is no ceiling.

    Raises:
        MeasurementError: If there is no floor, or more than a fifth of the points is below it.
    """
    up = np.array([0.0, 0.0, 1.0])
    level = [(plane, p) for plane, p in planes if abs(plane.normal @ up) > LEVEL]
    below, above = outermost(level, -up), outermost(level, up)
    if below is None:
        raise MeasurementError(
            f"No floor, from which heights are counted, among {len(planes)} planes in {len(samples.p)} points; scan "
            "the room from within, and far enough down to see the floor on all sides."
        )
    floor = refine_wall(samples, below, rng=rng)
    if (share := floor.behind(samples)) > BEYOND:
        raise MeasurementError(
            f"{100 * share:.0f} % of the points lie below the lowest large plane, at {-floor.plane.distance:.2f} m, so "
            "it is no floor from which heights can be counted; scan the room from within, and far enough down to see "
            "the floor on all sides."
        )
    up = -floor.plane.normal
    along = main_direction(planes)
    across = np.cross(up, along)
    across /= np.linalg.norm(across)
    rotation = np.stack([np.cross(across, up), across, up])
    frame = Frame(rotation, np.array([0.0, 0.0, floor.plane.distance]))
    ceiling = None if above is None else refine_wall(samples, above, rng=rng)
    if ceiling is not None and (share := ceiling.behind(samples)) > BEYOND:
        remark = (
            f"the plane at {ceiling.plane.distance:.2f} m is no ceiling: {100 * share:.0f} % of the points lie above"
        )
        return frame, floor, None, [remark]
    return frame, floor, ceiling, []
