"""The protocol of an estimator: from a frame's plane of the laser's colour to measured candidates on every line."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import Choice, FrameStripes


@runtime_checkable
class Estimator(Protocol):
    """Finds and measures stripes; the engine learns, chooses among candidates, and puts them on the image's lines."""

    candidates: int
    """Largest number of candidates of a line."""
    choices: tuple[Choice, ...]
    """Rules of choice that make sense of its candidates."""
    learns: bool
    """Whether the stripes of the first frames tell it width and speckle."""

    def measure(
        self,
        on: Plane,
        off: Plane | None,
        lamp_ratio: Float[Array, ""],
        search: Search,
        sites: Sites,
        linear: bool,
    ) -> FrameStripes:
        """Centres and their standard deviations in one frame; pure and traceable.

        Args:
            on: With the laser on; sample s of a line lies at `sites.pitch` times s [px].
            off: The same with the laser off, where there are any.
            lamp_ratio: Factor by which the light of the laser-off frame is multiplied [1].
            search: Where to look, the noise, and what is believed.
            sites: Where the plane lies in the image.
            linear: Whether codes are linear levels.

        Returns:
            Fields [candidates, lines of the plane]; zero where there is no stripe.
        """
