"""Drawings on disk: read back by other programs' readers, with the same numbers."""

import xml.etree.ElementTree as xml

import ezdxf
import numpy as np
import pytest

import jaxscan
from jaxscan.drawing import LAYERS, strokes
from jaxscan.errors import OutputError


@pytest.fixture(scope="module")
def plan(survey):
    return jaxscan.draw_plan(survey, heights_m=[1.0])


def test_dxf_is_sound_and_says_the_same(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.dxf")
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    audit = document.audit()
    assert not audit.errors and not audit.fixes
    assert document.header["$INSUNITS"] == 6 and document.header["$MEASUREMENT"] == 1
    # What programs go by that draw dimensions themselves, and zoom by the header.
    style = document.dimstyles.get(document.header["$DIMSTYLE"])
    assert document.header["$DIMTXT"] == style.dxf.dimtxt and 0.05 < style.dxf.dimtxt < 0.2
    low, high = plan.bounds()
    np.testing.assert_allclose([document.header["$EXTMIN"][:2], document.header["$EXTMAX"][:2]], [low, high])
    assert set(plan.layers) <= {layer.dxf.name for layer in document.layers}
    space = document.modelspace()
    measured = [one.get_measurement() for one in space.query("DIMENSION")]
    np.testing.assert_allclose(measured, [one.length_m for one in plan.dimensions], atol=1e-12)
    assert [one.dxf.text for one in space.query("DIMENSION")] == [one.words for one in plan.dimensions]
    for drawn, line in zip(space.query("LWPOLYLINE"), plan.lines, strict=True):
        np.testing.assert_allclose([point[:2] for point in drawn.get_points()], line.points, atol=1e-12)
        assert drawn.dxf.layer == line.layer
    assert [text.dxf.text for text in space.query("TEXT")] == [text.words for text in plan.texts]


def test_svg_is_to_scale(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.svg")
    root = xml.parse(tmp_path / "plan.svg").getroot()
    name = "{http://www.w3.org/2000/svg}"
    width, height = (float(root.get(side).removesuffix("mm")) for side in ("width", "height"))
    view = [float(number) for number in root.get("viewBox").split()]
    # 1 : 50.
    assert width == pytest.approx(20.0 * view[2], abs=0.06) and height == pytest.approx(20.0 * view[3], abs=0.06)
    groups = {group.get("id"): group for group in root.iter(f"{name}g")}
    assert list(groups) == plan.layers and set(groups) <= set(LAYERS)
    lines = [line for line in strokes(plan)[0] if line.layer == "A-WALL"]
    drawn = groups["A-WALL"].findall(f"{name}polyline")
    for line, element in zip(lines, drawn, strict=True):
        points = np.array([[float(x) for x in pair.split(",")] for pair in element.get("points").split()])
        np.testing.assert_allclose(points * [1, -1], line.points, atol=6e-5)
        assert (points >= view[:2]).all() and (points <= np.add(view[:2], view[2:])).all()
    words = {text.text for text in root.iter(f"{name}text")}
    assert words == {text.words for text in strokes(plan)[1]}


def test_pdf(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.pdf")
    written = (tmp_path / "plan.pdf").read_bytes()
    assert written.startswith(b"%PDF-") and b"/Type /Page" in written
    low, high = plan.bounds()
    box = written.split(b"/MediaBox [")[1].split(b"]")[0].split()
    # 1 : 50 in points of 1/72 inch, with a margin of 0.25 m.
    np.testing.assert_allclose([float(x) for x in box[2:]], (high - low + 0.5) * 20.0 / 25.4 * 72.0, atol=0.01)


def test_the_same_drawing_gives_the_same_bytes(plan, tmp_path):
    for suffix in (".svg", ".pdf"):
        written = []
        for name in ("a", "b"):
            jaxscan.save_drawing(plan, tmp_path / f"{name}{suffix}")
            written.append((tmp_path / f"{name}{suffix}").read_bytes())
        assert written[0] == written[1]


def test_refusals(plan, tmp_path):
    with pytest.raises(OutputError, match=r"known are \.dxf, \.svg, \.pdf"):
        jaxscan.save_drawing(plan, tmp_path / "plan.dwg")
    with pytest.raises(OutputError, match="create it first"):
        jaxscan.save_drawing(plan, tmp_path / "nowhere" / "plan.dxf")
    assert list(tmp_path.iterdir()) == []
