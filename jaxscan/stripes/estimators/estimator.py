"""The protocol of an estimator: from the planes of the laser's colour to measured candidates on every line."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from jaxscan.stripes.search import Planes, Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import Choice, MeasuredLines


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
    def locate_natively(self) -> Callable[[Planes, Search, ExtractionSetup], Any] | None:
        """A faster `locate` for a CPU, of NumPy planes with laser-off frames; None where there is none.

        A result is good until the next call in the same thread.
        """

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
