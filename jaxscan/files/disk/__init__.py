"""Bounded reading, atomic writing and checks of data, for all file formats."""

from jaxscan.files.disk.arrays import NPY_DAMAGE, check_arrays, read_arrays, read_npy_header, write_arrays
from jaxscan.files.disk.atomic import append_whole, check_writable, sync_to_disk, write_atomically
from jaxscan.files.disk.bounded import MEGABYTE, file_digest, parse_json, read_bounded, reported
from jaxscan.files.disk.config import load_toml, parse_toml
from jaxscan.files.disk.readable_json import readable_json
from jaxscan.files.disk.validation import FileModel, ImageSize, Integer, Number, check
