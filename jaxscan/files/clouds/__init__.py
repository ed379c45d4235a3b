"""Point clouds on disk."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.clouds.clouds import (
        READERS,
        WRITERS,
        check_cloud_path,
        load_cloud,
        read_cloud,
        save_cloud,
        save_cloud_with_pictures,
        save_clouds,
        save_stations,
    )
    from jaxscan.files.clouds.columns import Reading, Unit, parse_columns
    from jaxscan.files.clouds.e57 import FlatPicture, RoundPicture, Surroundings
    from jaxscan.files.clouds.formats import FORMATS
    from jaxscan.files.clouds.header import METRE, About, StoredCloud
    from jaxscan.files.clouds.placing import Up, in_metres, shifted, with_z_up
else:
    load_on_use(__name__)
