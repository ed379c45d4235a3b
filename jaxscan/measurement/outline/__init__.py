"""The outline of a room: its walls in order, their corners, lengths, areas and volume, and what is in the walls."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.measurement.outline.corners import Estimate
    from jaxscan.measurement.outline.level import Frame
    from jaxscan.measurement.outline.openings import Opening, find_openings
    from jaxscan.measurement.outline.outline import RoomOutline, Side, measure_outline
else:
    load_on_use(__name__)
