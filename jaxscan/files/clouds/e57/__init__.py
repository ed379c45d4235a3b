"""E57 (ASTM E2807), the exchange format of terrestrial scanning."""

from jaxscan.files.clouds.e57.pictures import FlatPicture, RoundPicture, Surroundings
from jaxscan.files.clouds.e57.reader import read_e57
from jaxscan.files.clouds.e57.writer import write_e57, write_e57_stations
