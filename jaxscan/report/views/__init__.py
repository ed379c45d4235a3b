"""The views of a calibration, each with its residuals and its photograph."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.views.panels import drawn_records, linked_record, views
    from jaxscan.report.views.thumbnails import thumbnail
else:
    load_on_use(__name__)
