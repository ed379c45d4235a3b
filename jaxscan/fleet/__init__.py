"""Who does the work of a batch: clusters of Dask, the only room that knows it."""

from jaxscan.fleet.batch import Report, Show, check_sight, run_batch
from jaxscan.fleet.clusters import (
    Certificates,
    ClusterChoice,
    check_choice,
    check_versions,
    make_certificates,
    open_cluster,
    package_digest,
)
