"""The views of a calibration, each with its residuals and its photograph."""

from jaxscan.report.views.panels import drawn_records, linked_record, views
from jaxscan.report.views.thumbnails import thumbnail
