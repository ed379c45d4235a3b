"""The calibration report: sentences, tables, figures and the page. Pictures of clouds."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report import words
    from jaxscan.report.clouds import (
        Beside,
        Facts,
        RoomPicture,
        Viewpoint,
        cloud_page,
        dimension_text,
        draw_cloud,
        facts_of,
        room_picture,
    )
    from jaxscan.report.drawing import pdf_of, png_of, with_scale
    from jaxscan.report.page import calibration_page, drawn_records, thumbnail
    from jaxscan.report.pictures import deviation_picture
    from jaxscan.report.tables import Parameter, outcome_rows, parameters, quality_rows
    from jaxscan.report.words import calibration_date
else:
    load_on_use(__name__)
