"""A calibration in words, tables and on a page; pictures of clouds."""

from jaxscan.report.page import calibration_page as calibration_page
from jaxscan.report.picture import View as View
from jaxscan.report.picture import draw_cloud as draw_cloud
from jaxscan.report.tables import Parameter as Parameter
from jaxscan.report.tables import outcome_rows as outcome_rows
from jaxscan.report.tables import parameters as parameters
from jaxscan.report.tables import quality_rows as quality_rows
