"""Clouds in pictures and on pages."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.clouds.facts import Beside, Facts, facts_of
    from jaxscan.report.clouds.page import cloud_page
    from jaxscan.report.clouds.picture import RoomPicture, Viewpoint, dimension_text, draw_cloud, room_picture
else:
    load_on_use(__name__)
