"""Sessions: a sweep or a calibration from beginning to end, every pair proven and on the disk before the next.

`run.py` has the two sessions that a caller may run; `lifecycle.py` is what both go through, from the lock to the seal,
and `ending.py` how they end. In between a `Session` (`session.py`) decides which record is taken next and which is in
doubt, by `recovery.py`, which brings the rig back after a fault, and `step.py`, which takes one pair.
"""

from scanrig.session.job import Devices, Hooks, SessionResult
from scanrig.session.placements import Operator, PlacementRequest
from scanrig.session.run import run_calibration, run_sweep
from scanrig.session.signals import Interrupts
