"""Rooms as IFC: sound by ifcopenshell's own validator, and as large as the room when their geometry is built."""

import ifcopenshell
import ifcopenshell.geom
import ifcopenshell.util.element
import ifcopenshell.validate
import numpy as np
import pytest

import jaxscan
from jaxscan.errors import OutputError
from jaxscan.files.ifc import THICKNESS_M

from ..measurement.rooms import HEIGHT, L_SHAPE


@pytest.fixture(scope="module")
def written(survey, tmp_path_factory):
    path = tmp_path_factory.mktemp("ifc") / "room.ifc"
    sheet = jaxscan.Sheet(project="House 7", room="Küche", date="2026-01-31", made_by="jaxscan 1", north_deg=30.0)
    jaxscan.save_ifc(survey, path, sheet=sheet)
    return path


@pytest.fixture(scope="module")
def model(written):
    return ifcopenshell.open(str(written))


def triangles(part, settings=None):
    """The body of a part in the frame of the plan: corners of its triangles [n, 3, 3], m."""
    settings = settings or ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    shape = ifcopenshell.geom.create_shape(settings, part).geometry
    return np.array(shape.verts).reshape(-1, 3)[np.array(shape.faces).reshape(-1, 3)]


def volume(part):
    a, b, c = np.moveaxis(triangles(part), 1, 0)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6.0)


def measured(part):
    return ifcopenshell.util.element.get_psets(part)["Jaxscan_Measured"]


def statements(model):
    logger = ifcopenshell.validate.json_logger()
    ifcopenshell.validate.validate(model, logger, express_rules=True)
    return logger.statements


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
def test_the_validator_finds_nothing(model, written, tmp_path):
    """The validator opens a file and leaves it to the garbage collector, which warns."""
    assert statements(model) == []
    (tmp_path / "broken.ifc").write_text(written.read_text().replace(".LENGTHUNIT.", ".NO_SUCH_UNIT.", 1))
    assert statements(str(tmp_path / "broken.ifc"))


def test_parts_and_names(model, survey):
    assert model.schema == "IFC4"
    assert [model.by_type(kind)[0].Name for kind in ("IfcProject", "IfcSpace")] == ["House 7", "Küche"]
    assert [wall.Name for wall in model.by_type("IfcWall")] == [side.name for side in survey.outline.loops[0]]
    assert len(model.by_type("IfcDoor")) == len(model.by_type("IfcWindow")) == 1
    assert len(model.by_type("IfcOpeningElement")) == 2
    (units,) = model.by_type("IfcUnitAssignment")
    assert {(unit.UnitType, unit.Prefix, unit.Name) for unit in units.Units} >= {("LENGTHUNIT", None, "METRE")}
    (north,) = (context.TrueNorth for context in model.by_type("IfcGeometricRepresentationContext", False))
    np.testing.assert_allclose(north.DirectionRatios, [0.5, np.sqrt(0.75)])
    assert len({part.GlobalId for part in model.by_type("IfcRoot")}) == len(model.by_type("IfcRoot"))


def test_the_space_is_as_large_as_the_room(model, survey):
    (space,) = model.by_type("IfcSpace")
    area = survey.outline.floor_area()
    # The L of 6 m x 5 m without 2.5 m x 2.5 m.
    assert volume(space) == pytest.approx(23.75 * HEIGHT, abs=0.01)
    assert measured(space)["FloorArea"] == area.value and measured(space)["FloorAreaSigma"] == area.sigma
    quantities = ifcopenshell.util.element.get_psets(space, qtos_only=True)["Qto_SpaceBaseQuantities"]
    assert quantities["NetFloorArea"] == area.value and quantities["Height"] == survey.outline.height().value


def test_the_inner_face_of_a_wall_is_where_it_was_measured(model, survey):
    """Its outer face is farther by the thickness, which is said to be no measurement."""
    for side, wall in zip(survey.outline.loops[0], model.by_type("IfcWall"), strict=True):
        corners = triangles(wall).reshape(-1, 3)
        depth = corners @ side.surface.plane.normal - side.surface.plane.distance
        # Walls in the model are upright, and those measured nearly.
        assert abs(depth.min()) < 1e-3 and depth.max() == pytest.approx(THICKNESS_M, abs=1e-3)
        assert corners[:, 2].max() == pytest.approx(HEIGHT, abs=1e-3) and corners[:, 2].min() == 0.0
        convention = ifcopenshell.util.element.get_psets(wall)["Jaxscan_Convention"]
        assert convention["Thickness"] == THICKNESS_M and "does not know it" in convention["Note"]
    lengths = sorted(measured(wall)["Length"] for wall in model.by_type("IfcWall"))
    sides = np.linalg.norm(np.array(L_SHAPE) - np.roll(L_SHAPE, 1, 0), axis=1)
    np.testing.assert_allclose(lengths, np.sort(sides), atol=1e-3)
    assert all(measured(wall)["LengthSigma"] > 0.0 for wall in model.by_type("IfcWall"))


def test_openings_go_through_their_walls(model, survey):
    """With its openings a wall is smaller by their volume, and what fills them is as wide and high."""
    without = ifcopenshell.geom.settings()
    without.set("disable-opening-subtractions", True)
    for kind, filling in (("door", "IfcDoor"), ("window", "IfcWindow")):
        (one,) = (each for loop in survey.openings for side in loop for each in side if each.kind == kind)
        (part,) = model.by_type(filling)
        wall = part.FillsVoids[0].RelatingOpeningElement.VoidsElements[0].RelatingBuildingElement
        assert wall.Name == one.side
        a, b, c = np.moveaxis(triangles(wall, without), 1, 0)
        whole = np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6.0
        assert whole - volume(wall) == pytest.approx(one.width.value * one.height.value * THICKNESS_M, abs=1e-3)
        assert part.OverallWidth == one.width.value and part.OverallHeight == one.height.value
        corners = triangles(part).reshape(-1, 3)
        assert (
            corners[:, 2].min() == pytest.approx(one.bottom.value) and measured(part)["WidthSigma"] == one.width.sigma
        )


def test_the_same_room_gives_the_same_bytes(survey, tmp_path):
    for name in ("a.ifc", "b.ifc"):
        jaxscan.save_ifc(survey, tmp_path / name)
    assert (tmp_path / "a.ifc").read_bytes() == (tmp_path / "b.ifc").read_bytes()


def test_other_suffixes_are_refused(survey, tmp_path):
    with pytest.raises(OutputError, match=r"known is \.ifc"):
        jaxscan.save_ifc(survey, tmp_path / "room.ifcxml")
    assert list(tmp_path.iterdir()) == []
