"""Meshes on disk, as another program reads them."""

import json
import struct

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.errors import OutputError
from jaxscan.files.clouds import save_cloud
from jaxscan.files.meshes import save_mesh
from jaxscan.surface import coloured_mesh, load_open3d, mesh_grid, textured_mesh
from tests.surface.conftest import scan


@pytest.fixture(scope="module")
def small():
    return scan(60, 30)


@pytest.fixture(scope="module")
def meshes(small):
    grid = mesh_grid(*small)
    red = lambda points, _: (
        np.zeros((len(points), 3), np.uint8) + np.uint8([200, 0, 0]),
        np.ones(len(points), np.bool_),
    )
    return coloured_mesh(grid), textured_mesh(grid, red, (4, 4))


def glb_of(path):
    data = path.read_bytes()
    magic, version, total, length = struct.unpack("<4sIII", data[:16])
    assert (magic, version, total) == (b"glTF", 2, len(data))
    return json.loads(data[20 : 20 + length]), data[28 + length :]


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_another_program_reads_the_same(meshes, tmp_path, suffix):
    mesh, _ = meshes
    assert save_mesh(mesh, tmp_path / f"room{suffix}") == [tmp_path / f"room{suffix}"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"room{suffix}"]
    found = load_open3d().io.read_triangle_mesh(str(tmp_path / f"room{suffix}"))
    vertices, faces = np.asarray(found.vertices), np.asarray(found.triangles)
    assert len(faces) == len(mesh.faces)
    expected = mesh.vertices[mesh.faces].astype(np.float64)
    if suffix == ".glb":
        expected = np.stack([expected[..., 0], expected[..., 2], -expected[..., 1]], -1)
    # A text has nine digits.
    np.testing.assert_allclose(vertices[faces], expected, atol=1e-7)
    if suffix != ".stl":
        assert len(vertices) == len(mesh.vertices)
        light = mesh.rgb / 255
        if suffix == ".glb":
            light = np.where(light <= 0.04045, light / 12.92, ((light + 0.055) / 1.055) ** 2.4)
        # The other program may have its vertices in an order of its own.
        np.testing.assert_allclose(np.asarray(found.vertex_colors)[faces], light[mesh.faces], atol=1 / 255)


def test_a_textured_obj_has_its_files_beside_it(meshes, tmp_path):
    _, mesh = meshes
    written = save_mesh(mesh, tmp_path / "my röom.obj")
    assert [path.name for path in written] == ["my_r_om.jpg", "my_r_om.mtl", "my röom.obj"]
    assert "mtllib my_r_om.mtl" in written[2].read_text()
    assert "map_Kd my_r_om.jpg" in written[1].read_text()
    found = load_open3d().io.read_triangle_mesh(str(written[2]))
    assert len(found.triangles) == len(mesh.faces)
    # Open3D gives faces without a material one of its own, first.
    picture = np.asarray(found.textures[-1])
    assert picture.shape == mesh.texture.shape
    # JPEG, and its colours have half the resolution.
    np.testing.assert_allclose(np.median(picture, (0, 1)), [200, 0, 0], atol=3)


def test_a_textured_glb_holds_its_picture(meshes, tmp_path):
    _, mesh = meshes
    save_mesh(mesh, tmp_path / "room.glb")
    content, data = glb_of(tmp_path / "room.glb")
    view = content["bufferViews"][content["images"][0]["bufferView"]]
    assert data[view["byteOffset"] :][:3] == b"\xff\xd8\xff"
    uv = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    start = content["bufferViews"][uv["bufferView"]]["byteOffset"]
    stored = np.frombuffer(data, np.float32, 2 * uv["count"], start).reshape(-1, 2)
    np.testing.assert_array_equal(stored, mesh.uv)


def test_a_mesh_far_away_keeps_its_digits(meshes, tmp_path):
    mesh, _ = meshes
    far = np.array([5e6, 3e6, 100.0])
    save_mesh(mesh._replace(vertices=mesh.vertices + far), tmp_path / "far.glb")
    content, data = glb_of(tmp_path / "far.glb")
    stored = np.frombuffer(data, np.float32, 3 * len(mesh.vertices)).reshape(-1, 3) + content["nodes"][0]["translation"]
    expected = mesh.vertices + far
    np.testing.assert_allclose(stored, np.stack([expected[:, 0], expected[:, 2], -expected[:, 1]], 1), atol=1e-6)


@pytest.mark.parametrize("name, said", [("room.xyz", "known are .glb, .obj"), ("none/room.glb", "does not exist")])
def test_a_name_that_cannot_be_written_is_refused(meshes, tmp_path, name, said):
    with pytest.raises(OutputError, match=said):
        save_mesh(meshes[0], tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_texture_that_the_format_has_not_is_refused(meshes, tmp_path):
    with pytest.raises(OutputError, match="mesh with a texture"):
        save_mesh(meshes[1], tmp_path / "room.ply")


def test_numbers_that_are_none_are_refused(meshes, tmp_path):
    vertices = meshes[0].vertices.copy()
    vertices[3] = np.nan
    with pytest.raises(OutputError, match="not finite"):
        save_mesh(meshes[0]._replace(vertices=vertices), tmp_path / "room.glb")
    assert not list(tmp_path.iterdir())


def test_the_verb_makes_a_mesh(small, tmp_path, capsys):
    save_cloud(small[0], tmp_path / "room.ply")
    words = ["mesh", str(tmp_path / "room.ply"), "-o", str(tmp_path / "room.glb"), "--json", str(tmp_path / "a.json")]
    assert main(words) == 0
    said = json.loads((tmp_path / "a.json").read_text())
    content, _ = glb_of(tmp_path / "room.glb")
    assert said["format"] == "jaxscan-mesh/1"
    assert said["faces"] == content["accessors"][-1]["count"] // 3
    assert "faces on" in capsys.readouterr().out


def test_what_was_decided_about_a_foreign_cloud_is_said(tmp_path, capsys):
    (tmp_path / "room.ply").write_text(HEADER.format(2) + "1000 0 3000\n2000 0 1000\n")
    # Points without a grid become no mesh, but by then it is said what they were taken for.
    assert main(["mesh", str(tmp_path / "room.ply"), "-o", str(tmp_path / "room.stl")]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "x, y, z by their names; the file does not say its unit" in said and "millimetres" in said


@pytest.mark.parametrize(
    "words, said",
    [
        (["-o", "{here}/room.txt"], "known are .glb"),
        (["-o", "{here}/room.ply"], "is the same file as"),
        (["-o", "{here}/a.glb", "--faces", "1"], "--faces: found 1"),
        (["-o", "{here}/a.glb", "--sigmas", "nan"], "--sigmas: found nan"),
        (["-o", "{here}/a.glb", "--grazing-deg", "95"], "--grazing-deg: found 95"),
        (["-o", "{here}/a.glb", "--texture", "{here}"], "name it with -c"),
        (["-o", "{here}/a.glb", "--texels", "2", "--faces", "9"], "--texels: found with --faces"),
        (["-o", "{here}/a.glb", "--texels", "2", "--poisson"], "--texels: found with --poisson"),
    ],
)
def test_bad_options_are_answered_in_one_line(small, tmp_path, capsys, words, said):
    save_cloud(small[0], tmp_path / "room.ply")
    assert main(["mesh", str(tmp_path / "room.ply"), *(word.format(here=tmp_path) for word in words)]) == 1
    error = capsys.readouterr().err
    assert said in error.replace("\n", " ") and "Traceback" not in error
    assert [path.name for path in tmp_path.iterdir()] == ["room.ply"]


HEADER = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    "points, said",
    [
        ([], "holds no points"),
        (["1 2 3"], "no grid"),
        (["1 2 3"] * 9, "no grid"),
        (["nan 2 3", "1 2 3"], "no grid"),
        (["1e30 2 3", "1 2 3"], "expected at most"),
    ],
)
def test_bad_clouds_are_answered_in_one_line(tmp_path, capsys, points, said):
    (tmp_path / "room.ply").write_text(HEADER.format(len(points)) + "".join(f"{one}\n" for one in points))
    assert main(["mesh", str(tmp_path / "room.ply"), "-o", str(tmp_path / "room.glb")]) == 1
    error = capsys.readouterr().err
    assert said in error.replace("\n", " ") and "Traceback" not in error
    assert not (tmp_path / "room.glb").exists()
