"""Point clouds on disk."""

from jaxscan.files.clouds.clouds import READERS as READERS
from jaxscan.files.clouds.clouds import WRITERS as WRITERS
from jaxscan.files.clouds.clouds import check_cloud_path as check_cloud_path
from jaxscan.files.clouds.clouds import load_cloud as load_cloud
from jaxscan.files.clouds.clouds import save_cloud as save_cloud
