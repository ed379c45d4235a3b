"""From a wanted accuracy to a rig: camera, lens, baseline and laser."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.design.choose import RigChoice, design_rig, wide_enough
    from jaxscan.design.rig import BLUR_PX, RigDesign, RigWish, Sensor, Spread, depth_sigma, spread_at
else:
    load_on_use(__name__)
