"""The laser's light, as the camera sees it."""

from jaxscan.simulation.light.bounce import line_pieces, returned_field
from jaxscan.simulation.light.lit import LitScene, laser_channel, lobe
from jaxscan.simulation.light.speckle import speckle_light
from jaxscan.simulation.light.stripe import LitSamples, RowTruth, laser_image, lit_samples, mirrored_samples, row_truth
