"""Captures on storage behind fsspec: `s3://`, `memory://`, `file://` and what else has a driver.

Storage belongs to others: its listings are checked like any file of a stranger, and it may fail now and then.
"""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.remote.copying import fetch_file, fetch_folder, read_remote
    from jaxscan.files.remote.listing import remote_digest
    from jaxscan.files.remote.place import is_remote
    from jaxscan.files.remote.search import find_captures
else:
    load_on_use(__name__)
