"""The laser-off images of a sweep as photographs of the room."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.photographs.colour import DEFAULT_BLEND, BlendSettings, colour_points
    from jaxscan.photographs.occluder import Occluder, make_occluder
    from jaxscan.photographs.panorama import (
        Panorama,
        PanoramaFrame,
        Projection,
        draw_distances,
        make_panorama,
        panorama_frame,
    )
    from jaxscan.photographs.photograph import (
        Album,
        Photograph,
        Photographs,
        Use,
        as_rgb,
        choose_evenly,
        enough_photographs,
        poses,
    )
    from jaxscan.photographs.surface import check_grid, surface_samples
    from jaxscan.photographs.transforms import (
        OPENGL_FROM_OPENCV,
        describe_cameras,
        ideal_camera,
        is_describable,
        undistort,
    )
else:
    load_on_use(__name__)
