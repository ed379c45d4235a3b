"""Programs that users open a cloud with: what each has of a file, through its own reader."""

import shutil
import subprocess
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest

from ..files.test_clouds import open3d


class Opened(NamedTuple):
    """What a program has of a cloud."""

    xyz: np.ndarray
    rgb: np.ndarray | None = None
    normals: np.ndarray | None = None
    columns: Mapping[str, np.ndarray] = MappingProxyType({})
    """Further numbers of points by the program's names."""
    poses: list[np.ndarray] | None = None
    """T_room_scanner of each scan; None where the program has none."""
    cells: tuple[int, int] | None = None
    """Size of the grid that the program itself knows."""
    epsg: int | None = None


def _module(name):
    return pytest.importorskip(name, reason=f"{name} is not installed: make programs")


def cloudcompare(path, folder):
    """CloudCompare's command line; all that it has is in the PLY that it writes."""
    command = shutil.which("CloudCompare") or shutil.which("cloudcompare")
    if command is None:
        pytest.skip("CloudCompare is not installed: make programs")
    target = folder / "cloudcompare.ply"
    words = ["-SILENT", "-AUTO_SAVE", "OFF", "-O", path, "-MERGE_CLOUDS", "-C_EXPORT_FMT", "PLY"]
    words += ["-PLY_EXPORT_FMT", "BINARY_LE", "-SAVE_CLOUDS", "FILE", target]
    # No window, and its settings stay in the folder of the test.
    environment = {"PATH": "/usr/bin:/bin", "QT_QPA_PLATFORM": "offscreen", "HOME": str(folder), "LC_ALL": "C.UTF-8"}
    done = subprocess.run(
        [command, *map(str, words)], env=environment, capture_output=True, timeout=120, check=False, text=True
    )
    # A file for each cloud, numbered where there are several.
    written = sorted(folder.glob("cloudcompare.ply*"))
    if not written:
        raise ValueError(done.stdout[-500:])
    parts = [plain_ply(one) for one in written]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    xyz = np.stack([columns.pop(axis) for axis in "xyz"], -1)
    rgb = [columns.pop(name, None) for name in ("red", "green", "blue")]
    normals = [columns.pop(name, None) for name in ("nx", "ny", "nz")]
    return Opened(
        xyz,
        None if rgb[0] is None else np.stack(rgb, -1),
        None if normals[0] is None else np.stack(normals, -1),
        {name.removeprefix("scalar_"): values for name, values in columns.items()},
    )


def plain_ply(path):
    """Columns of the vertices of a binary PLY, by a reader that is not ours."""
    kinds = {"float": "<f4", "double": "<f8", "int": "<i4", "uchar": "u1", "uint": "<u4", "short": "<i2"}
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    count = next(int(words[2]) for words in lines if words[:2] == ["element", "vertex"])
    fields = [(words[2], kinds[words[1]]) for words in lines if words[:1] == ["property"] and words[1] != "list"]
    table = np.frombuffer(body, np.dtype(fields), count)
    return {name: table[name] for name in table.dtype.names}


def meshlab(path, folder):
    """MeshLab, as a library."""
    pymeshlab = _module("pymeshlab")
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.load_new_mesh(str(path))
    # A mesh for each scan.
    found = [mesh for mesh in meshes if mesh.vertex_number()]
    turns = [mesh.transform_matrix()[:3, :3] for mesh in found]
    normals = np.concatenate([mesh.vertex_normal_matrix() @ R.T for mesh, R in zip(found, turns, strict=True)])
    columns = {}
    for name in ("sigma_random", "step", "row"):
        try:
            parts = [mesh.vertex_custom_scalar_attribute_array(f"scalar_{name}") for mesh in found]
        except pymeshlab.PyMeshLabException:
            continue
        columns[name] = np.concatenate(parts)
    coloured = all(mesh.has_vertex_color() for mesh in found)
    return Opened(
        np.concatenate([mesh.transformed_vertex_matrix() for mesh in found]),
        np.round(np.concatenate([mesh.vertex_color_matrix()[:, :3] for mesh in found]) * 255) if coloured else None,
        normals if np.abs(normals).any() else None,
        columns,
        poses=[mesh.transform_matrix() for mesh in found] if len(found) > 1 else None,
    )


def _open3d(path, folder):
    point = open3d().t.io.read_point_cloud(str(path)).point
    xyz = point.positions.numpy()
    if len(xyz) == 0:
        raise ValueError("no points")
    seen = np.isfinite(xyz).all(1)
    known = {name: point[name].numpy()[seen] for name in point if name not in ("positions", "colors", "normals")}
    return Opened(
        xyz[seen],
        point.colors.numpy()[seen] if "colors" in point else None,
        point.normals.numpy()[seen] if "normals" in point else None,
        {name.removeprefix("scalar_"): values[:, 0] for name, values in known.items()},
    )


def _laspy(path, folder):
    laspy = _module("laspy")
    las = laspy.read(path)
    names = list(las.point_format.extra_dimension_names)
    wkt = las.header.parse_crs()
    return Opened(
        np.asarray(las.xyz),
        np.stack([las.red, las.green, las.blue], -1) // 257,
        np.stack([las[f"normal_{axis}"] for axis in "xyz"], -1),
        {name: np.asarray(las[name]) for name in names},
        epsg=None if wkt is None else wkt.to_epsg(),
    )


def _pye57(path, folder):
    pye57 = _module("pye57")
    pyproj = _module("pyproj")
    file = pye57.E57(str(path))
    scans = [file.read_scan(k, colors=True, row_column=True, intensity=True) for k in range(file.scan_count)]
    headers = [file.get_header(k) for k in range(file.scan_count)]
    poses = []
    for header in headers:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = header.rotation_matrix, header.translation
        poses.append(pose)
    wkt = file.root["coordinateMetadata"].value()
    together = {name: np.concatenate([scan[name] for scan in scans]) for name in scans[0]}
    file.close()
    return Opened(
        np.stack([together[f"cartesian{axis}"] for axis in "XYZ"], -1),
        np.stack([together[f"color{name}"] for name in ("Red", "Green", "Blue")], -1),
        None,
        {"step": together["columnIndex"], "row": together["rowIndex"]},
        poses=poses,
        epsg=pyproj.CRS.from_wkt(wkt).to_epsg() if wkt else None,
    )


def _pcl(path, folder):
    """PCL's tools; what they have of a cloud is in the PCD that they write."""
    tools = {".pcd": ["pcl_convert_pcd_ascii_binary", "1"], ".ply": ["pcl_ply2pcd"]}
    if path.suffix not in tools:
        raise ValueError("no reader")
    command, *mode = tools[path.suffix]
    if shutil.which(command) is None:
        pytest.skip("PCL is not installed: make programs")
    target = folder / "pcl.pcd"
    done = subprocess.run(
        [command, path, target, *mode], capture_output=True, timeout=120, check=False, text=True, errors="replace"
    )
    if not target.exists():
        raise ValueError(done.stderr[-500:])
    columns = plain_pcd(target)
    seen = np.isfinite(columns["x"])
    columns = {name.removeprefix("scalar_"): values[seen] for name, values in columns.items()}
    packed = columns.pop("rgb").view("<u4")
    return Opened(
        np.stack([columns.pop(axis) for axis in "xyz"], -1),
        np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], -1),
        np.stack([columns.pop(f"normal_{axis}") for axis in "xyz"], -1),
        columns,
    )


def plain_pcd(path):
    """Columns of a binary PCD, by a reader that is not ours."""
    head, body = path.read_bytes().split(b"DATA binary\n", 1)
    header = {words[0]: words[1:] for words in (line.split() for line in head.decode("ascii").splitlines())}
    kinds = {"F": "f", "I": "i", "U": "u"}
    fields = zip(header["FIELDS"], header["TYPE"], header["SIZE"], strict=True)
    table = np.frombuffer(
        body, np.dtype([(name, f"<{kinds[kind]}{size}") for name, kind, size in fields]), int(*header["POINTS"])
    )
    return {name: table[name].copy() for name in table.dtype.names}


def _trimesh(path, folder):
    trimesh = _module("trimesh")
    cloud = trimesh.load(path)
    colours = np.asarray(cloud.colors)
    vertices = (cloud.metadata or {}).get("_ply_raw", {}).get("vertex", {}).get("data")
    columns = {} if vertices is None else {name: np.asarray(vertices[name]).ravel() for name in vertices.dtype.names}
    normals = [columns.get(f"n{axis}") for axis in "xyz"]
    return Opened(
        np.asarray(cloud.vertices),
        colours[:, :3] if len(colours) else None,
        None if normals[0] is None else np.stack(normals, -1),
        {name.removeprefix("scalar_"): values for name, values in columns.items()},
    )


PROGRAMS = {
    "CloudCompare": cloudcompare,
    "MeshLab": meshlab,
    "Open3D": _open3d,
    "PCL": _pcl,
    "laspy": _laspy,
    "pye57": _pye57,
    "trimesh": _trimesh,
}
