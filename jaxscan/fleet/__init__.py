"""Steps of projects on the machines one has, by Dask."""

from jaxscan.fleet.batch import Report, Show, check_sight, run_batch
