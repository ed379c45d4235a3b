"""Clouds in pictures and on pages."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.clouds.facts import Beside, Facts, facts_of
    from jaxscan.report.clouds.marks import RoomPicture, room_picture
    from jaxscan.report.clouds.page import cloud_page
    from jaxscan.report.clouds.picture import draw_cloud
    from jaxscan.report.clouds.room import dimension_text
    from jaxscan.report.clouds.view import View
else:
    load_on_use(__name__)
