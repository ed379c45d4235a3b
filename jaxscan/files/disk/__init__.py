"""Bounded reading, atomic writing and checks of data, for all file formats."""

from jaxscan.files.disk.arrays import NPY_DAMAGE, check_arrays, read_arrays, read_npy_header, write_arrays
from jaxscan.files.disk.atomic import (
    append_whole,
    check_writable,
    open_to_append,
    sync_to_disk,
    write_atomically,
    write_together,
)
from jaxscan.files.disk.bounded import MAX_DEPTH, file_digest, is_deep, parse_json, reported, too_deep
from jaxscan.files.disk.config import load_toml, parse_toml
from jaxscan.files.disk.opening import MEGABYTE, NO_LINK, check_name, open_regular, read_bounded, shown
from jaxscan.files.disk.partial import forget_partials, partial_file, partial_folder, remove_left
from jaxscan.files.disk.readable_json import readable_json
from jaxscan.files.disk.validation import FileModel, ImageSize, Integer, Number, check
from jaxscan.files.disk.xml import Element, parse_xml
