"""`jaxscan mesh`: makes a mesh of a cloud."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from jaxscan import api, surface
from jaxscan.cli.help import Arg
from jaxscan.cli.options import CloudPath, OptionalCalibrationPath, at_least, check_paths, positive
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import OptionError
from jaxscan.files import clouds as cloud_files
from jaxscan.surface.mesh import DEFAULT_MESH


if TYPE_CHECKING:
    from jaxscan.geometry import Scanner
    from jaxscan.reconstruction import PointCloud
    from jaxscan.surface import Mesh, MeshSettings


_TARGET = "Mesh to write; the suffix chooses the format (.glb .obj .ply .stl)."


def mesh(
    cloud: CloudPath,
    /,
    *,
    output: Annotated[Path, Arg(short="-o", text=_TARGET)],
    calibration: OptionalCalibrationPath = None,
    texture: Path | None = None,
    texels: int | None = None,
    faces: int | None = None,
    poisson: bool = False,
    bridge: bool = False,
    sigmas: float = DEFAULT_MESH.sigmas,
    bend: float = DEFAULT_MESH.bend,
    grazing_deg: float = DEFAULT_MESH.grazing_deg,
) -> None:
    """Make a mesh of a cloud: `jaxscan mesh room.ply -o room.glb`.

    Neighbours of the grid are joined where the difference of their depths is one that their normals explain, up to
    `--sigmas` of their noise and `--bend` of their distance. A full turn is closed; each laser is a sheet.

    Args:
        cloud: Cloud (.ply or .npz) that `jaxscan reconstruct` wrote.
        calibration: Calibration file, which gives the place of the camera, and where photographs show a point.
        texture: Folder of the captured sweep, whose laser-off images are drawn on the mesh (.glb and .obj).
        texels: Texels of the texture on each side of a cell of the grid; by default one for each pixel of the camera.
        faces: Most faces: the mesh is simplified where it is flat.
        poisson: One closed surface through all points, by Open3D: for several stations, and to fill holes.
        bridge: Fill single missing points between neighbours on one surface.
        sigmas: How many standard deviations the depths of neighbours may differ by, beyond what their slopes explain.
        bend: How far a neighbour may lie off the surface, as a share of the distance between their rays.
        grazing_deg: Leave out faces seen from further beside their normal [degrees].
    """
    at_least(1, "--texels", texels)
    at_least(4, "--faces", faces)
    positive("--sigmas", sigmas)
    positive("--bend", bend)
    if not 0 < grazing_deg < 90:
        raise OptionError(f"--grazing-deg: found {grazing_deg:g}, expected an angle between 0 and 90.")
    textured = texture is not None
    if textured and calibration is None:
        raise OptionError("--texture: needs the calibration of its camera; name it with -c.")
    if texels is not None and (faces is not None or poisson):
        other = "--poisson" if poisson else "--faces"
        raise OptionError(f"--texels: found with {other}, expected without: there are no cells of the grid.")
    written = api.mesh_paths(output, textured=textured)
    reads = {"CLOUD": cloud, "--calibration": calibration, "--texture": texture}
    check_paths(reads, {"--output": written})
    api.check_mesh_path(output, textured=textured)
    settings = surface.MeshSettings(sigmas=sigmas, bend=bend, grazing_deg=grazing_deg, bridge=bridge)
    points, notes = cloud_files.in_metres(cloud_files.read_cloud(cloud))
    scanner = None if calibration is None else api.load_scanner(calibration)
    out = console(f"{cloud}: {note}" for note in notes)
    start = time.perf_counter()
    if texture is None or scanner is None:
        made = _mesh_of(points, scanner, settings, faces=faces, poisson=poisson)
    else:
        sweep = api.open_capture(texture)
        out.notes(api.photograph_notes(sweep, scanner, "pictures"))
        with progress_bar("Drawing the texture") as progress:
            drawn = api.Texture(sweep, texels, progress)
            if faces is None and not poisson:
                made = api.textured_mesh(points, scanner, drawn, settings=settings)
            else:
                plain = _mesh_of(points, scanner, settings, faces=faces, poisson=poisson)
                made = api.draw_texture(plain, points, scanner, drawn)
    seconds = time.perf_counter() - start
    api.save_mesh(made, output)
    out.print(f"{len(made.faces):,} faces on {len(made.vertices):,} vertices in {seconds:.1f} s")
    if made.texture is not None:
        out.print(f"texture of {made.texture.shape[1]} x {made.texture.shape[0]} px")
    out.print(f"written: {', '.join(map(str, written))}")
    if output.suffix.lower() == ".obj":
        out.print("z is up in it: choose Z as the axis that is up where it is imported; a GLB stands upright by itself")
    result = {
        "notes": notes,
        "meshes": [str(path) for path in written],
        "vertices": len(made.vertices),
        "faces": len(made.faces),
        "seconds_s": seconds,
        "texture_px": None if made.texture is None else [made.texture.shape[1], made.texture.shape[0]],
    }
    emit_json(result)


def _mesh_of(
    points: "PointCloud", scanner: "Scanner | None", settings: "MeshSettings", *, faces: int | None, poisson: bool
) -> "Mesh":
    """A mesh without a texture."""
    made = api.poisson_mesh(points) if poisson else api.mesh_cloud(points, scanner=scanner, settings=settings)
    return made if faces is None else api.simplify_mesh(made, faces)
