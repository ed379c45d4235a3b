"""Stripes to a coloured cloud."""

from jaxscan.reconstruction.cloud import PointCloud as PointCloud
from jaxscan.reconstruction.reconstruct import extract_sweep as extract_sweep
from jaxscan.reconstruction.reconstruct import reconstruct as reconstruct
from jaxscan.reconstruction.settings import ReconstructSettings as ReconstructSettings
from jaxscan.reconstruction.sweep import FrameChunk as FrameChunk
from jaxscan.reconstruction.sweep import Sweep as Sweep
from jaxscan.reconstruction.sweep import SweepSource as SweepSource
