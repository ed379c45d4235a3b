"""When a pair is believed, when a step is what it was, and what the calibration board should do next.

`proof.py` gives the verdict on a pair, by `frame_pair.py`, `ridges.py` and `measures.py`; `limits.py` is what it keeps
to. `leaks.py` looks over many pairs, `compare.py` at the same place taken again. `guide.py` and `boardview.py` are
about boards.
"""

from scanrig.checks.boardview import BoardView, Pose
from scanrig.checks.compare import Likeness, compare_pairs
from scanrig.checks.guide import Coverage, Guide
from scanrig.checks.leaks import PLACES, LeakWatch
from scanrig.checks.limits import ProofLimits
from scanrig.checks.proof import PairProof, prove_pair
