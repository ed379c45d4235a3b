"""Drawings on disk: read back by other programs' readers, with the same numbers."""

import struct
import xml.etree.ElementTree as xml

import ezdxf
import numpy as np
import pytest
from matplotlib.image import imread

import jaxscan
from jaxscan.drawing import LAYERS, lay_out, strokes
from jaxscan.errors import OptionError, OutputError
from jaxscan.files.products import describe_product
from jaxscan.vision.lossless import SIGNATURE, chunk


@pytest.fixture(scope="module")
def plan(survey):
    sheet = jaxscan.Sheet(project="House 7", room="Kitchen", date="2026-01-31")
    return jaxscan.draw_plan(survey, heights_m=[1.0], sheet=sheet)


def test_dxf_is_sound_and_says_the_same(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.dxf")
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    audit = document.audit()
    assert not audit.errors and not audit.fixes
    assert document.header["$INSUNITS"] == 6 and document.header["$MEASUREMENT"] == 1
    # What programs go by that draw dimensions themselves, and zoom by the header.
    style = document.dimstyles.get(document.header["$DIMSTYLE"])
    assert document.header["$DIMTXT"] == style.dxf.dimtxt == pytest.approx(1.8e-3 * plan.sheet.scale)
    low, high = plan.bounds()
    np.testing.assert_allclose([document.header["$EXTMIN"][:2], document.header["$EXTMAX"][:2]], [low, high])
    assert set(plan.layers) <= {layer.dxf.name for layer in document.layers}
    space = document.modelspace()
    measured = [one.get_measurement() for one in space.query("DIMENSION")]
    np.testing.assert_allclose(measured, [one.length_m for one in plan.dimensions], atol=1e-12)
    written = [one.dxf.text.replace("\\P", " ") for one in space.query("DIMENSION")]
    assert written == [one.words for one in plan.dimensions]
    for drawn, line in zip(space.query("LWPOLYLINE"), plan.lines, strict=True):
        np.testing.assert_allclose([point[:2] for point in drawn.get_points()], line.points, atol=1e-12)
        assert drawn.dxf.layer == line.layer
    assert [text.dxf.text for text in space.query("TEXT")] == [text.words for text in plan.texts]


def test_the_sheet_of_a_dxf_is_a_layout_to_scale(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.dxf")
    document = ezdxf.readfile(tmp_path / "plan.dxf")
    assert document.layouts.names() == ["Model", "A4 1-50"]
    layout = document.paperspace("A4 1-50")
    (_, view) = layout.viewports()
    assert view.dxf.view_height / view.dxf.height == pytest.approx(0.05)
    assert {"1 : 50", "A4"} <= {text.dxf.text for text in layout.query("TEXT")}


def on_paper(plan, points):
    """Where points of the plan are on the sheet, from its lower left corner [mm]."""
    page = lay_out(plan)
    return page.middle_mm + 1e3 / plan.sheet.scale * (points - page.middle_m)


def test_svg_is_to_scale(plan, tmp_path):
    jaxscan.save_drawing(plan, tmp_path / "plan.svg")
    root = xml.parse(tmp_path / "plan.svg").getroot()
    name = "{http://www.w3.org/2000/svg}"
    assert [root.get(each) for each in ("width", "height", "viewBox")] == ["210mm", "297mm", "0 0 210 297"]
    assert plan.sheet.scale == 50
    groups = {group.get("id"): group for group in root.iter(f"{name}g")}
    assert set(plan.layers) <= set(groups) <= set(LAYERS)
    lines = [line for line in strokes(plan)[0] if line.layer == "A-DOOR"]
    drawn = groups["A-DOOR"].findall(f"{name}polyline")
    # The first is the sample in the legend.
    for line, element in zip(lines, drawn[1:], strict=True):
        points = np.array([[float(x) for x in pair.split(",")] for pair in element.get("points").split()])
        np.testing.assert_allclose([0, 297] + points * [1, -1], on_paper(plan, line.points), atol=6e-4)
    words = {text.text for text in root.iter(f"{name}text")}
    assert {text.words for text in strokes(plan)[1]} <= words
    assert {"Kitchen", "House 7", "2026-01-31", "1 : 50", "A4", "not known", "jaxscan"} <= words


def test_all_is_on_the_sheet(plan):
    page = lay_out(plan)
    points = np.concatenate([*(line.points for line in page.lines), *(text.box() for text in page.texts)])
    low, high = plan.sheet.frame_mm
    assert (points >= low).all() and (points <= high).all()


@pytest.mark.parametrize(
    ("size", "scale", "sides"), [("a4", 50, (210, 297)), ("a3", 50, (420, 297)), ("a1", 20, (841, 594))]
)
def test_pdf_and_png_are_sheets_true_to_scale(survey, tmp_path, size, scale, sides):
    plan = jaxscan.draw_plan(survey, sheet=jaxscan.Sheet(size, scale=scale))
    jaxscan.save_drawing(plan, tmp_path / "plan.pdf")
    written = (tmp_path / "plan.pdf").read_bytes()
    assert written.startswith(b"%PDF-") and b"/Type /Page" in written
    box = [float(x) for x in written.split(b"/MediaBox [")[1].split(b"]")[0].split()]
    # Points of 1/72 inch.
    np.testing.assert_allclose(box[2:], np.array(sides) / 25.4 * 72.0, atol=0.01)
    jaxscan.save_drawing(plan, tmp_path / "plan.png", dpi=50)
    picture = imread(tmp_path / "plan.png")
    np.testing.assert_allclose(picture.shape[1::-1], np.array(sides) / 25.4 * 50, atol=1.0)
    # The longest wall is black where it lies on the paper.
    walls = [line.points for line in plan.lines if line.layer == "A-WALL"]
    wall = max(walls, key=lambda ends: np.linalg.norm(ends[1] - ends[0]))
    at = on_paper(plan, wall[0] + np.array([0.3, 0.5, 0.7])[:, None] * (wall[1] - wall[0])) / 25.4 * 50
    for x, y in at:
        row, column = picture.shape[0] - y, x
        around = picture[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2, :3]
        assert around.mean(-1).min() < 0.6


def test_names_of_strangers(survey, tmp_path):
    """Control characters, markup, and a name that is longer than the sheet."""
    odd = "a\n\x01<b>&\ud800"
    plan = jaxscan.draw_plan(survey, sheet=jaxscan.Sheet(project=odd, room="long " * 200))
    for suffix in (".svg", ".dxf", ".pdf"):
        jaxscan.save_drawing(plan, tmp_path / f"plan{suffix}")
    texts = [text.text for text in xml.parse(tmp_path / "plan.svg").getroot().iter("{http://www.w3.org/2000/svg}text")]
    assert r"a\n\x01<b>&\ud800" in texts
    assert not ezdxf.readfile(tmp_path / "plan.dxf").audit().errors
    jaxscan.save_ifc(survey, tmp_path / "room.ifc", sheet=plan.sheet)
    assert (tmp_path / "room.ifc").read_text("ascii").startswith("ISO-10303-21;")


def test_a_file_of_a_drawing_says_its_sheet(plan, survey, tmp_path):
    """As `jaxscan info` does, which reads what is in the file."""
    for suffix in (".svg", ".pdf", ".png", ".dxf"):
        jaxscan.save_drawing(plan, tmp_path / f"plan{suffix}")
    jaxscan.save_ifc(survey, tmp_path / "plan.ifc")
    about = {
        suffix: describe_product(tmp_path / f"plan{suffix}", error=OutputError)
        for suffix in (".svg", ".pdf", ".png", ".dxf", ".ifc")
    }
    sheet = [round(side) for side in lay_out(plan).size_mm]
    assert [about[suffix]["sheet_mm"] for suffix in (".svg", ".pdf", ".png")] == [sheet] * 3
    assert about[".dxf"]["dimensions"] == len(plan.dimensions)
    assert about[".ifc"]["walls"] == len(survey.outline.loops[0]) and about[".ifc"]["spaces"] == 1


def test_a_file_that_is_no_drawing_says_so(tmp_path):
    (tmp_path / "plan.svg").write_text(f'<svg width="{"9" * 400}mm" height="3mm">')
    with pytest.raises(OutputError, match="is no SVG file that can be read"):
        describe_product(tmp_path / "plan.svg", error=OutputError)
    # Its pixels are square, and have no size.
    header = struct.pack(">II", 4, 3) + bytes([8, 0, 0, 0, 0])
    square = chunk(b"IHDR", header) + chunk(b"pHYs", struct.pack(">IIB", 1, 1, 0))
    (tmp_path / "plan.png").write_bytes(SIGNATURE + square)
    assert describe_product(tmp_path / "plan.png", error=OutputError)["sheet_mm"] is None


def test_the_largest_standard_scale_that_fits(survey):
    """A room of 6 m x 5 m, and 27 mm of dimensions around it."""
    assert jaxscan.draw_plan(survey).sheet.scale == 50
    assert jaxscan.draw_plan(survey, sheet=jaxscan.Sheet("a2")).sheet.scale == 20
    with pytest.raises(OptionError, match=r"1 : 20 takes 304 x 354 mm .* a4 has .* choose 1 : 50 or a larger sheet"):
        jaxscan.draw_plan(survey, sheet=jaxscan.Sheet("a4", scale=20))
    with pytest.raises(OptionError, match="The sheet is A5, expected one of a4"):
        jaxscan.draw_plan(survey, sheet=jaxscan.Sheet("A5"))


def test_the_same_drawing_gives_the_same_bytes(plan, tmp_path):
    for suffix in (".svg", ".pdf", ".png"):
        written = []
        for name in ("a", "b"):
            jaxscan.save_drawing(plan, tmp_path / f"{name}{suffix}")
            written.append((tmp_path / f"{name}{suffix}").read_bytes())
        assert written[0] == written[1]


def test_refusals(plan, tmp_path):
    with pytest.raises(OutputError, match=r"known are \.dxf, \.svg, \.pdf, \.png"):
        jaxscan.save_drawing(plan, tmp_path / "plan.dwg")
    with pytest.raises(OutputError, match="create it first"):
        jaxscan.save_drawing(plan, tmp_path / "nowhere" / "plan.dxf")
    with pytest.raises(OptionError, match="--dpi: found 5, expected 20 to 1200"):
        jaxscan.save_drawing(plan, tmp_path / "plan.png", dpi=5)
    assert list(tmp_path.iterdir()) == []
