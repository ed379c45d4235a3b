"""Bounded reading, atomic writing and checks of data, for all file formats."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.disk.arrays import NPY_DAMAGE, check_arrays, read_arrays, read_npy_header, write_arrays
    from jaxscan.files.disk.config import (
        FileModel,
        ImageSize,
        Integer,
        Number,
        check,
        load_toml,
        parse_toml,
        readable_json,
    )
    from jaxscan.files.disk.lock import FolderLock
    from jaxscan.files.disk.reading import (
        COPY_FIRST,
        MAX_DEPTH,
        MEGABYTE,
        NO_LINK,
        check_name,
        file_digest,
        is_address,
        is_deep,
        open_regular,
        parse_json,
        read_bounded,
        reported,
        shown,
        too_deep,
    )
    from jaxscan.files.disk.writing import (
        Part,
        append_whole,
        check_writable,
        forget_partials,
        is_outside,
        make_folder,
        open_to_write,
        partial_file,
        partial_folder,
        refuse_links,
        remove_stale,
        sync_to_disk,
        whole_folder,
        write_atomically,
        write_together,
    )
    from jaxscan.files.disk.xml import Element, parse_xml
else:
    load_on_use(__name__)
