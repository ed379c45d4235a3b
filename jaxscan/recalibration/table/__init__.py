"""Faults of the table's angles: wrong steps per turn, lost steps."""

from jaxscan.recalibration.table.check import check_angles
from jaxscan.recalibration.table.corrections import say_lost_steps
from jaxscan.recalibration.table.sheet import points_of_records
