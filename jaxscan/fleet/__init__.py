"""Who does the work of a batch: clusters of Dask, the only room that knows it.

`jaxscan.fleet.batch`, which loads Dask, is imported by its own name.
"""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.fleet.clusters import (
        Certificates,
        ClusterChoice,
        check_choice,
        check_versions,
        make_certificates,
        open_cluster,
        package_digest,
        patience_of,
    )
else:
    load_on_use(__name__)
