"""Doubts about a sweep, a sentence each: contradictions within it, found by statistics of the sweep itself."""

from jaxscan.reconstruction.doubts.journal import journal_doubts
from jaxscan.reconstruction.doubts.motion import cloud_points, refuse_other_motion
from jaxscan.reconstruction.doubts.profiles import profile_doubts
from jaxscan.reconstruction.doubts.seen import FrameWatch, Seen
from jaxscan.reconstruction.doubts.sweep import sweep_doubts
