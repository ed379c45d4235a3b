"""A sweep in chunks of one size, computed ahead, gathered on one grid."""

from jaxscan.reconstruction.streaming.batches import Batch, batches, chunk_records
from jaxscan.reconstruction.streaming.grid import GrowingCloud, GrowingStripes
