"""The laser's light, as the camera sees it."""

from jaxscan.simulation.light.gloss import lobe
from jaxscan.simulation.light.speckle import speckle_light
from jaxscan.simulation.light.stripe import LitSamples, LitScene, RowTruth, laser_image, lit_samples, row_truth
