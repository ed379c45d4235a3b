"""The protocol of an estimator: from the planes of the laser's colour to measured candidates on every line."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Int8

from jaxscan.geometry import Array
from jaxscan.stripes.search import Planes, Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import Choice, FrameStripes, MeasuredLines


class Found(NamedTuple):
    """Stripes on the lines of the image, as of `choose_stripes`."""

    stripes: FrameStripes
    chosen: Int8[Array, "frames lines"] | None


@runtime_checkable
class Estimator(Protocol):
    """Finds and measures stripes; the engine learns, chooses among candidates, and puts them on the image's lines.

    Coordinates are those of the laser's plane: sample s of a line lies at `setup.sites.pitch` times s [px].
    """

    candidates: int
    """Largest number of candidates of a line."""
    choices: tuple[Choice, ...]
    """Rules of choice that make sense of its candidates."""
    learns: bool
    """Whether the stripes of the first frames tell it width and speckle."""

    @property
    def find_natively(self) -> Callable[[Planes, Search, ExtractionSetup], Found] | None:
        """`locate`, `measure` and the choice faster on a CPU, of NumPy planes with laser-off frames; None where there
        is no such function."""

    def locate(self, planes: Planes, search: Search, setup: ExtractionSetup) -> Any:
        """Where stripes may be, as `measure` takes it; pure and traceable."""

    def measure(self, located: Any, lamp_ratio: Any, search: Search, setup: ExtractionSetup) -> MeasuredLines:
        """Centres and their standard deviations; pure and traceable.

        Args:
            located: The result of either search.
            lamp_ratio: Factor by which the light of each frame's laser-off image is multiplied [frames].
            search: Where to look, and the noise.
            setup: Frames, laser and settings.
        """
