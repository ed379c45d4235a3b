"""Programs that write a cloud with their own code: points, colours, normals and intensity, as far as they have them."""

import shutil
import subprocess
from typing import NamedTuple

import numpy as np
import pytest

from ..files.test_clouds import open3d


class Given(NamedTuple):
    """What a program is given to write."""

    xyz: np.ndarray
    rgb: np.ndarray
    normals: np.ndarray
    intensity: np.ndarray
    """Between 0 and 1."""


def given(count=300):
    """Points on a sphere of 2 m, about 5 m from the origin, in micrometres that text holds."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    xyz = np.round(2 * normals + [3.0, -4.0, 1.0], 4)
    rgb = rng.integers(0, 256, (count, 3), np.uint8)
    return Given(xyz.astype(np.float32).astype(np.float64), rgb, normals, np.round(rng.random(count), 3))


def _module(name):
    return pytest.importorskip(name, reason=f"{name} is not installed: make programs")


def _command(*names):
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"{names[0]} is not installed: make programs")
    return found


def _run(words, folder):
    # No window, and its settings stay in the folder of the test.
    environment = {"PATH": "/usr/bin:/bin", "QT_QPA_PLATFORM": "offscreen", "HOME": str(folder), "LC_ALL": "C.UTF-8"}
    subprocess.run([*map(str, words)], env=environment, capture_output=True, timeout=120, check=False)


def _plain(path, cloud):
    """A PLY of neither of the two, from which programs without a library start."""
    table = np.zeros(
        len(cloud.xyz),
        [*((axis, "<f8") for axis in "xyz"), *((f"n{axis}", "<f4") for axis in "xyz")]
        + [(name, "u1") for name in ("red", "green", "blue")]
        + [("scalar_Intensity", "<f4")],
    )
    for k, axis in enumerate("xyz"):
        table[axis], table[f"n{axis}"] = cloud.xyz[:, k], cloud.normals[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        table[name] = cloud.rgb[:, k]
    table["scalar_Intensity"] = cloud.intensity
    kinds = {"f8": "double", "f4": "float", "u1": "uchar"}
    lines = [f"property {kinds[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}", *lines, "end_header", ""]
    path.write_bytes("\n".join(head).encode() + table.tobytes())
    return path


def cloudcompare(path, cloud, folder):
    kind = {".ply": ["PLY", "-PLY_EXPORT_FMT", "BINARY_LE"], ".xyz": ["ASC", "-PREC", "6", "-ADD_HEADER"]}
    source = _plain(folder / "source.ply", cloud)
    words = ["-SILENT", "-AUTO_SAVE", "OFF", "-O", source, "-C_EXPORT_FMT", *kind.get(path.suffix, ["ASC"])]
    if path.suffix == ".xyz":
        words += ["-ADD_PTS_COUNT"]
    _run([_command("CloudCompare", "cloudcompare"), *words, "-SAVE_CLOUDS", "FILE", path], folder)


def meshlab(path, cloud, folder):
    pymeshlab = _module("pymeshlab")
    meshes = pymeshlab.MeshSet(verbose=False)
    colours = np.column_stack([cloud.rgb / 255, np.ones(len(cloud.rgb))])
    meshes.add_mesh(
        pymeshlab.Mesh(
            cloud.xyz, v_normals_matrix=cloud.normals, v_color_matrix=colours, v_scalar_array=cloud.intensity
        )
    )
    # Normals are left out of a PLY unless they are asked for.
    options = {"save_vertex_normal": True} if path.suffix == ".ply" else {}
    meshes.save_current_mesh(str(path), **options)


def _open3d(path, cloud, folder):
    o3d = open3d()
    points = o3d.t.geometry.PointCloud(o3d.core.Tensor(cloud.xyz.astype(np.float32)))
    points.point.colors = o3d.core.Tensor(cloud.rgb)
    points.point.normals = o3d.core.Tensor(cloud.normals.astype(np.float32))
    points.point.intensity = o3d.core.Tensor(cloud.intensity.astype(np.float32)[:, None])
    o3d.t.io.write_point_cloud(str(path), points)


def _pcl(path, cloud, folder):
    """From a PLY, through PCL's own PCD."""
    middle = folder / "middle.pcd"
    _run([_command("pcl_ply2pcd"), _plain(folder / "source.ply", cloud), middle], folder)
    if path.suffix == ".ply":
        _run([_command("pcl_pcd2ply"), middle, path], folder)
    else:
        _run([_command("pcl_convert_pcd_ascii_binary"), middle, path, "2"], folder)


def _laspy(path, cloud, folder):
    laspy = _module("laspy")
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 1e-4)
    las = laspy.LasData(header)
    las.xyz = cloud.xyz
    las.red, las.green, las.blue = cloud.rgb.T.astype(np.uint16) * 256
    las.intensity = np.round(cloud.intensity * 1000).astype(np.uint16)
    las.add_extra_dim(laspy.ExtraBytesParams("NormalX", np.float32))
    las.add_extra_dim(laspy.ExtraBytesParams("NormalY", np.float32))
    las.add_extra_dim(laspy.ExtraBytesParams("NormalZ", np.float32))
    las.NormalX, las.NormalY, las.NormalZ = cloud.normals.T.astype(np.float32)
    las.write(str(path))


def _pye57(path, cloud, folder):
    file = _module("pye57").E57(str(path), mode="w")
    names = {f"cartesian{axis}": cloud.xyz[:, k].copy() for k, axis in enumerate("XYZ")}
    names |= {f"color{name}": cloud.rgb[:, k].copy() for k, name in enumerate(("Red", "Green", "Blue"))}
    file.write_scan_raw({**names, "intensity": cloud.intensity.copy()})
    file.close()


def _trimesh(path, cloud, folder):
    trimesh = _module("trimesh")
    trimesh.PointCloud(cloud.xyz, colors=np.column_stack([cloud.rgb, np.full(len(cloud.rgb), 255, np.uint8)])).export(
        str(path)
    )


WRITERS = {
    "CloudCompare": cloudcompare,
    "MeshLab": meshlab,
    "Open3D": _open3d,
    "PCL": _pcl,
    "laspy": _laspy,
    "pye57": _pye57,
    "trimesh": _trimesh,
}
