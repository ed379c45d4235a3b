"""Checks of frames: the proof of a pair, the comparison of retaken steps, and advice for placing the board."""

from scanrig.checks.compare import PLACES, LeakWatch, LightWatch, Likeness, compare_pairs
from scanrig.checks.guide import BoardView, Coverage, Guide, Pose
from scanrig.checks.proof import PairProof, ProofLimits, prove_pair
