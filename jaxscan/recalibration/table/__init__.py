"""Faults of the table's angles: wrong steps per turn, lost steps."""

from jaxscan.recalibration.table.check import check_angles, say_lost_steps
from jaxscan.recalibration.table.walls import points_of_records
