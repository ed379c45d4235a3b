"""The joint adjustment of scanner, stations, surfaces, tracked points and angles."""

from jaxscan.recalibration.adjust.joint import adjust
