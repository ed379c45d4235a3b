"""When a pair is believed, when a step is what it was, and what the calibration board should do next.

`proof.py` gives the verdict on a pair, by `frame_pair.py`, `ridges.py` and `measures.py`; `limits.py` is what it keeps
to. `leaks.py` looks over many pairs, `compare.py` at the same place taken again. `guide.py` and `boardview.py` are
about boards.
"""

from scanrig.checks.boardview import BoardView as BoardView
from scanrig.checks.boardview import Pose as Pose
from scanrig.checks.compare import Likeness as Likeness
from scanrig.checks.compare import compare_pairs as compare_pairs
from scanrig.checks.guide import Coverage as Coverage
from scanrig.checks.guide import Guide as Guide
from scanrig.checks.leaks import PLACES as PLACES
from scanrig.checks.leaks import LeakWatch as LeakWatch
from scanrig.checks.limits import ProofLimits as ProofLimits
from scanrig.checks.proof import PairProof as PairProof
from scanrig.checks.proof import prove_pair as prove_pair
