"""Stripes on boards fitted through the print under them, which a first solve places."""

from jaxscan.observation.printed.refit import fit_on_print
from jaxscan.observation.printed.windows import Sight
