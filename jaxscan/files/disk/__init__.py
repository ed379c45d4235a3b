"""What every file needs: bounded reading, whole writing, checked data."""

from jaxscan.files.disk.arrays import NPY_DAMAGE as NPY_DAMAGE
from jaxscan.files.disk.arrays import read_arrays as read_arrays
from jaxscan.files.disk.arrays import read_npy_header as read_npy_header
from jaxscan.files.disk.arrays import write_arrays as write_arrays
from jaxscan.files.disk.atomic import append_whole as append_whole
from jaxscan.files.disk.atomic import check_writable as check_writable
from jaxscan.files.disk.atomic import sync_to_disk as sync_to_disk
from jaxscan.files.disk.atomic import write_atomically as write_atomically
from jaxscan.files.disk.bounded import MEGABYTE as MEGABYTE
from jaxscan.files.disk.bounded import file_digest as file_digest
from jaxscan.files.disk.bounded import parse_json as parse_json
from jaxscan.files.disk.bounded import read_bounded as read_bounded
from jaxscan.files.disk.config import load_toml as load_toml
from jaxscan.files.disk.config import parse_toml as parse_toml
from jaxscan.files.disk.readable_json import readable_json as readable_json
from jaxscan.files.disk.validation import FileModel as FileModel
from jaxscan.files.disk.validation import ImageSize as ImageSize
from jaxscan.files.disk.validation import Integer as Integer
from jaxscan.files.disk.validation import Number as Number
from jaxscan.files.disk.validation import check as check
