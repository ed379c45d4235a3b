"""The sources of images in which features are tracked, and the functions that look at images."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import AbstractBoard
from jaxscan.stripes import PixelFormat


@runtime_checkable
class SourceRecord(Protocol):
    """One record of a sweep."""

    @property
    def off(self) -> Sequence[object]:
        """Images of the laser-off frame; empty without one."""


@runtime_checkable
class ImageSource(Protocol):
    """A captured sweep whose images are read one by one; `files.Capture` is one."""

    @property
    def records(self) -> Sequence[SourceRecord]: ...
    @property
    def pixel_format(self) -> PixelFormat: ...
    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""

    def image(self, reference: Any, /) -> np.ndarray:
        """One image as it is stored, uint8 [rows, columns(, 3)]."""


class Cylinder(NamedTuple):
    """Images unrolled on a cylinder about the turntable's axis through the camera: there a turn is a shift.

    Unrolled coordinates are x along the azimuth and y down, in `scale` pixels per radian of azimuth and per unit of
    the tangent of elevation; the first column and row are at `left` and `top`.
    """

    u: Float[np.ndarray, "rows columns"]
    """Pixel column that each place of the unrolled image shows [px]; far outside where no pixel does."""
    v: Float[np.ndarray, "rows columns"]
    left: float
    top: float
    scale: float


class Walk(NamedTuple):
    """Key images in the order in which tracks go through them; the last ones may be the first ones again."""

    cylinder: Cylinder
    predict: Callable[[Float[np.ndarray, "n 2"], int, int], Float[np.ndarray, "n 2"]]
    """Unrolled places in one step of the walk to those in another one."""
    steps: int
    begin: int
    """Steps in which tracks may begin: they come first."""


class Followed(NamedTuple):
    """Features that were followed through images, by step of the walk [px]."""

    q: Float[np.ndarray, "sightings 2"]
    sigma: Float[np.ndarray, " sightings"]
    """Standard deviation of u and of v by the noise in the image [px]."""
    step: Int[np.ndarray, " sightings"]
    track: Int[np.ndarray, " sightings"]


class FoundTargets(NamedTuple):
    """Corners of targets in one image."""

    name: tuple[str, ...]
    q: Float[np.ndarray, "corners 2"]
    sigma: Float[np.ndarray, " corners"]


Follow = Callable[[Iterator[np.ndarray], Walk], Followed]
FindTargets = Callable[[np.ndarray, AbstractBoard | None, str | None], FoundTargets]


class FeatureEyes(NamedTuple):
    """The functions that look at laser-off images; `vision` has them, by OpenCV."""

    to_grey: Callable[[np.ndarray, PixelFormat], np.ndarray]
    has_texture: Callable[[Sequence[np.ndarray]], tuple[bool, str]]
    """Whether some grey images have enough texture, and why not, in words."""
    follow: Follow
    find_dictionary: Callable[[Sequence[np.ndarray]], str | None]
    """The dictionary of the markers that some grey images show; None where they show none."""
    find_targets: FindTargets
