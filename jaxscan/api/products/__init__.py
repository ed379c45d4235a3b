"""The public verbs for boards, and for the products of a scan."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.api.products.boards import BoardSheets, draw_board, save_board, write_sheets
    from jaxscan.api.products.designs import save_designed_rig
    from jaxscan.api.products.drawings import check_drawing_path, save_drawing
    from jaxscan.api.products.frames import align_cloud
    from jaxscan.api.products.meshes import Texture, draw_texture, mesh_cloud, poisson_mesh, textured_mesh
    from jaxscan.api.products.photographs import (
        check_panorama_path,
        colour_cloud,
        draw_panorama,
        export_photographs,
        has_photographs,
        open_photographs,
        panorama_paths,
        photograph_notes,
        save_panorama,
    )
    from jaxscan.api.products.scans import began, save_scan
else:
    load_on_use(__name__)
