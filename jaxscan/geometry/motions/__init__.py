"""How a scanner moves between its records: about an axis, along a line, or not at all."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.geometry.motions.linear_stage import LinearStage
    from jaxscan.geometry.motions.motion import AbstractMotion, Carries
    from jaxscan.geometry.motions.registry import MOTION_BLOCKS
    from jaxscan.geometry.motions.still import Still
    from jaxscan.geometry.motions.turntable import ANGLE_PARAMETERS, Turntable
else:
    load_on_use(__name__)
