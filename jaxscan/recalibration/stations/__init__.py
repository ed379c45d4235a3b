"""First poses of stations."""

from jaxscan.recalibration.stations.place import place_stations
