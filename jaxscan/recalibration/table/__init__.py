"""Faults of the table's angles: wrong steps per turn, lost steps."""

from jaxscan.recalibration.table.check import check_angles
