"""The calibration report: sentences, tables, figures and the page. Pictures of clouds."""

from jaxscan.report.deviations import deviation_picture
from jaxscan.report.drawn import pdf_of
from jaxscan.report.page import calibration_page
from jaxscan.report.picture import View, draw_cloud
from jaxscan.report.scales import with_scale
from jaxscan.report.tables import Parameter, outcome_rows, parameters, quality_rows
