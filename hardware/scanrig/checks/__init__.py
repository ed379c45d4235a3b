"""Checks of frames: the proof of a pair, the comparison of retaken steps, and advice for placing the board.

`proof.py` gives the verdict on a pair, with `frame_pair.py`, `ridges.py` and `measures.py`; `limits.py` has its limits.
`leaks.py` and `light.py` follow the leak and the light of the room over many pairs, `compare.py` compares two pairs of
the same place. `guide.py` and `boardview.py` are about boards.
"""

from scanrig.checks.compare import PLACES, LeakWatch, LightWatch, Likeness, compare_pairs
from scanrig.checks.guide import BoardView, Coverage, Guide, Pose
from scanrig.checks.proof import PairProof, ProofLimits, prove_pair
