"""Rooms as IFC 4, through ifcopenshell: walls, what is in them, and the space between them."""

import datetime
import importlib.util
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxscan.drawing import Sheet, Survey, outward
from jaxscan.errors import DependencyError, MeasurementError
from jaxscan.files.disk import Part
from jaxscan.measurement.outline import Estimate, Opening


THICKNESS_M = 0.1
"""Thickness of walls [m]: a convention, since nobody saw how thick they are."""
LEAF_M = 0.04
"""Thickness of doors, windows and panels [m], also a convention."""
NOT_MEASURED = (
    f"The inner face of the wall is measured. Its thickness of {THICKNESS_M:g} m, outwards, is a convention: a scan "
    "from within does not know it."
)
MEASURED, ASSUMED = "Jaxscan_Measured", "Jaxscan_Convention"
"""Sets of properties: what was measured with one standard deviation each, and what was not measured."""
_NAMESPACE = uuid.UUID("6f1e2b0c-52f4-5d0b-9a35-0d3b7f6c1a54")


def check_ifc() -> None:
    """Check that IFC can be written.

    Raises:
        DependencyError: If ifcopenshell is not installed.
    """
    if importlib.util.find_spec("ifcopenshell") is None:
        raise DependencyError('IFC needs ifcopenshell: pip install "jaxscan[ifc]"')


def write_ifc(survey: Survey, sheet: Sheet, path: Part) -> None:
    """Write a room as IFC 4 in metres, in the frame of its plan.

    A wall is a solid from floor to ceiling, whose inner face is the one that was measured. Doors and windows are
    openings with what fills them; panels, which may be windows or pictures, are proxies before the wall.

    Args:
        survey: The room.
        sheet: Names, date and north, as on a drawing.
        path: File to write.

    Raises:
        DependencyError: If ifcopenshell is not installed.
        MeasurementError: If the room has no wall.
        OSError: If the file cannot be written.
    """
    check_ifc()
    import ifcopenshell

    room = survey.outline
    if not any(side.seen for loop in room.loops for side in loop):
        raise MeasurementError("The room has no wall that was seen, so there is no model of it.")
    height = room.height()
    top = float(survey.p[:, 2].max()) if height is None else height.value
    every = np.round([corner.at for loop in room.corners() for corner in loop], 6)
    model = _Model(ifcopenshell.file(schema="IFC4"), f"{every.tolist()} {sheet.project} {sheet.room}")
    model.begin(sheet)
    storey = model.storey
    space = model.room(survey, sheet, top)
    model.add("IfcRelAggregates", "parts of the storey", RelatingObject=storey, RelatedObjects=[space])
    elements: list[Any] = []
    for number, (loop, corners) in enumerate(zip(room.loops, room.corners(), strict=True)):
        at = np.array([corner.at[:2] for corner in corners])
        beyond = outward(at, THICKNESS_M)
        for i, side in enumerate(loop):
            if not side.seen:
                continue
            j = (i + 1) % len(at)
            area = room.wall_area(number, i)
            measured = {"Length": room.lengths()[number][i], "Height": height, "Area": area}
            wall = model.wall(side.name, np.stack([at[i], at[j], beyond[j], beyond[i]]), top, measured)
            elements.append(wall)
            for k, one in enumerate(survey.openings[number][i], 1):
                elements += model.opening(f"{side.name} {one.kind} {k}", wall, one, at[i], at[j])
    model.add("IfcRelContainedInSpatialStructure", "storey", RelatingStructure=storey, RelatedElements=elements)
    header = model.file.header
    header.file_name.time_stamp = f"{_day(sheet.date)}T00:00:00"
    header.file_name.originating_system = sheet.made_by
    header.file_name.preprocessor_version = sheet.made_by
    path.write_text(model.file.to_string(), encoding="ascii")


def _day(words: str) -> str:
    """A date of ISO 8601, as the header needs it; a sheet may have none, or write it in another way."""
    try:
        return datetime.date.fromisoformat(words).isoformat()
    except ValueError:
        return "1970-01-01"


@dataclass
class _Model:
    """A file of IFC, and what its parts share."""

    file: Any
    identity: str
    """Makes the GUIDs repeatable: the same room has the same ones."""
    body: Any = None
    storey: Any = None
    origin: Any = None
    counted: dict[str, int] = field(default_factory=dict)

    def make(self, kind: str, *values: Any, **named: Any) -> Any:
        """An entity without a GUID."""
        return self.file.create_entity(kind, *values, **named)

    def add(self, kind: str, key: str, **named: Any) -> Any:
        """An entity with a GUID, which depends on the room, its kind and a key."""
        import ifcopenshell.guid

        name = f"{self.identity} {kind} {key}"
        self.counted[name] = self.counted.get(name, 0) + 1
        unique = uuid.uuid5(_NAMESPACE, f"{name} {self.counted[name]}")
        return self.make(kind, GlobalId=ifcopenshell.guid.compress(unique.hex), **named)

    def begin(self, sheet: Sheet) -> None:
        """Project, units, site, building and storey."""
        self.origin = self.make("IfcAxis2Placement3D", self.point(0.0, 0.0, 0.0))
        north = None
        if sheet.north_deg is not None:
            turned = np.radians(sheet.north_deg)
            north = self.make("IfcDirection", (float(np.sin(turned)), float(np.cos(turned))))
        context = self.make("IfcGeometricRepresentationContext", None, "Model", 3, 1e-5, self.origin, north)
        self.body = self.make(
            "IfcGeometricRepresentationSubContext",
            ContextIdentifier="Body",
            ContextType="Model",
            ParentContext=context,
            TargetView="MODEL_VIEW",
        )
        kinds = (
            ("LENGTHUNIT", "METRE"),
            ("AREAUNIT", "SQUARE_METRE"),
            ("VOLUMEUNIT", "CUBIC_METRE"),
            ("PLANEANGLEUNIT", "RADIAN"),
        )
        units = self.make("IfcUnitAssignment", [self.make("IfcSIUnit", None, kind, None, name) for kind, name in kinds])
        project = self.add(
            "IfcProject",
            "project",
            Name=sheet.project or "jaxscan",
            Description=f"Made by {sheet.made_by}",
            RepresentationContexts=[context],
            UnitsInContext=units,
        )
        above, placement = project, None
        for kind, name in (("IfcSite", "Site"), ("IfcBuilding", "Building"), ("IfcBuildingStorey", "Storey")):
            placement = self.make("IfcLocalPlacement", placement, self.origin)
            more = {"Elevation": 0.0} if kind == "IfcBuildingStorey" else {}
            part = self.add(kind, name, Name=name, ObjectPlacement=placement, CompositionType="ELEMENT", **more)
            self.add("IfcRelAggregates", f"parts above {name}", RelatingObject=above, RelatedObjects=[part])
            above = part
        self.storey = above

    def point(self, *xyz: float) -> Any:
        """A point [m]."""
        return self.make("IfcCartesianPoint", tuple(map(float, xyz)))

    def placed(self, below: Any, at: tuple[float, float, float] = (0.0, 0.0, 0.0), along: Any = None) -> Any:
        """A place relative to that of another part: x along a direction of the plan [2], z up."""
        if along is None:
            axes = self.make("IfcAxis2Placement3D", self.point(*at))
        else:
            up, x = (self.make("IfcDirection", tuple(map(float, way))) for way in ((0, 0, 1), (*along, 0)))
            axes = self.make("IfcAxis2Placement3D", self.point(*at), up, x)
        return self.make("IfcLocalPlacement", below.ObjectPlacement, axes)

    def solid(self, outline: np.ndarray, height: float, holes: Sequence[np.ndarray] = ()) -> Any:
        """A body over a polygon [n, 2] with holes, from z = 0 up, m."""

        def closed(points: np.ndarray) -> Any:
            ring = [self.point(*point) for point in points]
            return self.make("IfcPolyline", [*ring, ring[0]])

        if holes:
            rings = [closed(hole) for hole in holes]
            profile = self.make("IfcArbitraryProfileDefWithVoids", "AREA", None, closed(outline), rings)
        else:
            profile = self.make("IfcArbitraryClosedProfileDef", "AREA", None, closed(outline))
        up = self.make("IfcDirection", (0.0, 0.0, 1.0))
        body = self.make("IfcExtrudedAreaSolid", profile, self.origin, up, float(height))
        shape = self.make("IfcShapeRepresentation", self.body, "Body", "SweptSolid", [body])
        return self.make("IfcProductDefinitionShape", None, None, [shape])

    def room(self, survey: Survey, sheet: Sheet, top: float) -> Any:
        """The space between the walls."""
        outline = survey.outline
        loops = [np.array([corner.at[:2] for corner in loop]) for loop in outline.corners()]
        space = self.add(
            "IfcSpace",
            "room",
            Name=sheet.room or "Room",
            ObjectPlacement=self.placed(self.storey),
            Representation=self.solid(loops[0], top, loops[1:]),
            CompositionType="ELEMENT",
            PredefinedType="INTERNAL",
        )
        measured = {"FloorArea": outline.floor_area(), "Height": outline.height(), "Volume": outline.volume()}
        quantities = [
            self.make(f"Ifc{kind}", name, None, None, found.value)
            for kind, name, found in (
                ("QuantityArea", "NetFloorArea", measured["FloorArea"]),
                ("QuantityLength", "Height", measured["Height"]),
                ("QuantityVolume", "NetVolume", measured["Volume"]),
            )
            if found is not None and found.known
        ]
        if quantities:
            self.define(
                space, self.add("IfcElementQuantity", "room", Name="Qto_SpaceBaseQuantities", Quantities=quantities)
            )
        self.measures(space, measured)
        if outline.height() is None:
            self.assumes(space, f"No ceiling was seen. The height of {top:.3f} m is that of the highest point.")
        return space

    def wall(self, name: str, outline: np.ndarray, top: float, measured: dict[str, Estimate | None]) -> Any:
        """A wall over its outline in the plan [4, 2], m, inner face first."""
        wall = self.add(
            "IfcWall",
            name,
            Name=name,
            ObjectPlacement=self.placed(self.storey),
            Representation=self.solid(outline, top),
            PredefinedType="NOTDEFINED",
        )
        self.measures(wall, measured)
        self.assumes(wall, NOT_MEASURED, Thickness=THICKNESS_M)
        return wall

    def opening(self, name: str, wall: Any, one: Opening, start: np.ndarray, end: np.ndarray) -> list[Any]:
        """An opening with what fills it, or a panel before the wall: those that the storey contains."""
        along = (end - start) / np.linalg.norm(end - start)
        at = (*(start + one.left.value * along), one.bottom.value)
        wide, high = one.width.value, one.height.value
        measured = {"Width": one.width, "Height": one.height, "FromWallStart": one.left, "AboveFloor": one.bottom}

        def box(near: float, far: float) -> Any:
            # x is along the wall and y into the room, which is on its left.
            return self.solid(np.array([[0.0, near], [wide, near], [wide, far], [0.0, far]]), high)

        if one.kind == "panel":
            depth = float(np.clip(-(one.depth_m or 0.0), 0.005, LEAF_M))
            panel = self.add(
                "IfcBuildingElementProxy",
                name,
                Name=name,
                ObjectPlacement=self.placed(self.storey, at, along),
                Representation=box(0.0, depth),
                PredefinedType="NOTDEFINED",
            )
            self.measures(panel, measured)
            self.assumes(panel, "Flat before the wall: a window, a picture or a board.")
            return [panel]
        hole = self.add(
            "IfcOpeningElement",
            name,
            Name=name,
            ObjectPlacement=self.placed(self.storey, at, along),
            Representation=box(-2.0 * THICKNESS_M, THICKNESS_M),
            PredefinedType="OPENING",
        )
        self.add("IfcRelVoidsElement", name, RelatingBuildingElement=wall, RelatedOpeningElement=hole)
        self.measures(hole, measured)
        if one.kind == "opening":
            return []
        kind, types = ("IfcDoor", "DOOR") if one.kind == "door" else ("IfcWindow", "WINDOW")
        filling = self.add(
            kind,
            name,
            Name=name,
            ObjectPlacement=self.placed(self.storey, at, along),
            Representation=box(-0.5 * (THICKNESS_M + LEAF_M), -0.5 * (THICKNESS_M - LEAF_M)),
            OverallHeight=high,
            OverallWidth=wide,
            PredefinedType=types,
        )
        self.add("IfcRelFillsElement", name, RelatingOpeningElement=hole, RelatedBuildingElement=filling)
        self.measures(filling, measured)
        self.assumes(filling, "Its place within the wall, its thickness, hinge and swing are not measured.")
        return [filling]

    def measures(self, part: Any, found: Mapping[str, Estimate | None]) -> None:
        """What was measured of a part, as far as it is known."""
        kinds = {"Area": "IfcAreaMeasure", "FloorArea": "IfcAreaMeasure", "Volume": "IfcVolumeMeasure"}
        values: dict[str, tuple[str, Any]] = {}
        for name, one in found.items():
            if one is not None and (one.known or one.value == 0.0):
                kind = kinds.get(name, "IfcLengthMeasure")
                values |= {name: (kind, one.value), f"{name}Sigma": (kind, one.sigma)}
        if values:
            self.properties(part, MEASURED, values)

    def assumes(self, part: Any, note: str, **values: float) -> None:
        """What was not measured of a part."""
        lengths = {name: ("IfcLengthMeasure", value) for name, value in values.items()}
        self.properties(part, ASSUMED, {"Note": ("IfcText", note), **lengths})

    def properties(self, part: Any, name: str, values: dict[str, tuple[str, Any]]) -> None:
        """A set of properties of a part."""
        listed = [
            self.make("IfcPropertySingleValue", key, None, self.make(kind, value))
            for key, (kind, value) in values.items()
        ]
        self.define(part, self.add("IfcPropertySet", f"{part.Name} {name}", Name=name, HasProperties=listed))

    def define(self, part: Any, definition: Any) -> None:
        """Give a part a set of properties or quantities."""
        key = f"{part.is_a()} {part.Name} {definition.Name}"
        self.add("IfcRelDefinesByProperties", key, RelatedObjects=[part], RelatingPropertyDefinition=definition)
