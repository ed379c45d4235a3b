"""Any kind of cluster behind one door: on this machine, one that runs, SLURM, Kubernetes, or machines by SSH."""

from jaxscan.fleet.clusters.certificates import Certificates, make_certificates
from jaxscan.fleet.clusters.checks import check_versions, package_digest
from jaxscan.fleet.clusters.choice import ClusterChoice, check_choice, patience_of
from jaxscan.fleet.clusters.opening import open_cluster
