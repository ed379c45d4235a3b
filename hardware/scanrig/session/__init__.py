"""Sessions: a sweep or a calibration from beginning to end; pairs are proven and written while the table turns.

`run.py` has the two sessions that a caller may run, from the lock to the seal, and what their ends do; `aim.py` only
looks; `interrupts.py` hears Ctrl-C. A `Session` (`session.py`) takes records and tracks which are suspect. It uses
`recovery.py`, which recovers the rig after a fault, and `steps.py`, which takes, proves and writes one pair.
"""

from scanrig.session.aim import Sight, Wish, run_aiming
from scanrig.session.interrupts import Interrupts
from scanrig.session.job import Devices, Hooks, SessionResult
from scanrig.session.run import Operator, PlacementRequest, run_calibration, run_sweep
