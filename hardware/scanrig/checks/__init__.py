"""Checks of frames: the proof of a pair, the comparison of retaken steps, and advice for placing the board.

`proof.py` gives the verdict on a pair, with `frame_pair.py`, `ridges.py` and `measures.py`; `limits.py` has its limits.
`leaks.py` and `light.py` follow the leak and the light of the room over many pairs, `compare.py` compares two pairs of
the same place. `guide.py` and `boardview.py` are about boards.
"""

from scanrig.checks.boardview import BoardView, Pose
from scanrig.checks.compare import Likeness, compare_pairs
from scanrig.checks.guide import Coverage, Guide
from scanrig.checks.leaks import PLACES, LeakWatch
from scanrig.checks.light import LightWatch
from scanrig.checks.limits import ProofLimits
from scanrig.checks.proof import PairProof, prove_pair
