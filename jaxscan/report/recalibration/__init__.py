"""A recalibration in sentences, figures and as a page."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.recalibration import words
    from jaxscan.report.recalibration.page import recalibration_page
    from jaxscan.report.recalibration.words import (
        closure_lines,
        drift_words,
        gain_lines,
        headline,
        hold_out_lines,
        known_lines,
        length_lines,
        moved_rows,
        station_rows,
        table_lines,
        wall_lines,
    )
else:
    load_on_use(__name__)
