"""The world of the calibration's tests: boards and stripes by a forward model in plain NumPy."""

from ..calibration.conftest import world as world
