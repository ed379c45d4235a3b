"""Bounded reading, atomic writing and checks of data, for all file formats."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.disk.arrays import NPY_DAMAGE, check_arrays, read_arrays, read_npy_header, write_arrays
    from jaxscan.files.disk.atomic import check_writable, write_atomically, write_together
    from jaxscan.files.disk.bounded import MAX_DEPTH, file_digest, is_deep, parse_json, reported, too_deep
    from jaxscan.files.disk.config import load_toml, parse_toml
    from jaxscan.files.disk.folders import whole_folder
    from jaxscan.files.disk.lock import FolderLock
    from jaxscan.files.disk.opening import MEGABYTE, NO_LINK, check_name, open_regular, read_bounded, shown
    from jaxscan.files.disk.partial import Part, forget_partials, partial_file, partial_folder, remove_left
    from jaxscan.files.disk.readable_json import readable_json
    from jaxscan.files.disk.validation import FileModel, ImageSize, Integer, Number, check
    from jaxscan.files.disk.writing import (
        append_whole,
        is_outside,
        make_folder,
        open_to_append,
        open_to_write,
        refuse_links,
        sync_to_disk,
    )
    from jaxscan.files.disk.xml import Element, parse_xml
else:
    load_on_use(__name__)
