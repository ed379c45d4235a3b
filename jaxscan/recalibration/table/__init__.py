"""Steps that the table lost, by the walls of ordinary sweeps."""

from jaxscan.recalibration.table.steps import check_angles
from jaxscan.recalibration.table.walls import points_of_records
