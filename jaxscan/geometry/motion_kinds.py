"""The kinds of motion: one table, which captures, files, options, reports and projects read.

A new kind is a row here and a class in `motions.py`. Nothing heavy is imported, so that `--help` may read it.
"""

from typing import TYPE_CHECKING, Literal, NamedTuple


class MotionKind(NamedTuple):
    """The properties of a kind of motion."""

    motion: str
    """Its class in `motions.py`."""
    unit: Literal["rad", "m", "pose", ""]
    """Unit of its positions; where poses are given a position is the number of the record."""
    part: str
    """The part that is solved."""
    blocks: tuple[str, ...]
    """Names of its blocks of unknowns; `--free` and `--hold` offer them."""
    stops: str
    """Name of its positions in messages."""
    least: float
    """Positions closer than this are one stop [rad or m]."""
    capture: str
    """Words for the captures of boards that determine it."""
    numbers: tuple[tuple[str, ...], str]
    """Keys of its table in files that `--axis` gives, three numbers each; and both in words."""
    unfit: tuple[str, ...] = ()
    """Products of a project that are left out ..."""
    why: str = ""
    """... and the reason."""

    @property
    def key(self) -> str:
        """Key of the position in the journal of a capture: degrees, metres, or a whole pose."""
        return {"m": "position_m", "pose": "pose"}.get(self.unit, "angle_deg")


_TABLE = MotionKind(
    "Turntable",
    "rad",
    "axis",
    ("axis", "gain", "harmonics"),
    "table angles",
    1e-3,
    "leave the board standing and turn the table between images (same `placement`, other `angle_deg`): 4 placements "
    "at 9 table angles each",
    (("point_m", "direction"), "a point of the axis in metres and its direction"),
)

MOTIONS: dict[str, MotionKind] = {
    "scanner": _TABLE,
    "object": _TABLE._replace(
        unfit=("plan", "panorama"), why="a table that carries the object turns no camera in a room"
    ),
    "linear": MotionKind(
        "LinearStage",
        "m",
        "direction of travel",
        ("travel", "gain"),
        "positions of the stage",
        1e-4,
        "leave the board standing and move the stage between images (same `placement`, other `position_m`): 4 "
        "placements at 5 positions each",
        (("direction",), "the direction of travel"),
        # A stage may move along the walls of a room, so a plan is tried.
        unfit=("panorama",),
        why="a stage does not turn the camera",
    ),
    "poses": MotionKind(
        "Hand",
        "pose",
        "place of the camera on the hand",
        ("hand",),
        "poses of the hand",
        0.5,
        "leave the board standing and go round it with the hand (same `placement`, other `pose`): 12 poses, turned by "
        "20 degrees and more about two axes",
        (("translation_m", "rotation"), "the camera's place on the hand in metres and its rotation vector in radians"),
        unfit=("plan", "panorama"),
        why="a hand may look anywhere",
    ),
    "nothing": MotionKind(
        "Still",
        "",
        "motion",
        (),
        "positions",
        0.0,
        "",
        ((), ""),
        unfit=("mesh", "plan", "panorama"),
        why="profiles of a scanner that stands still have no neighbours",
    ),
}
"""The kinds by their names in files: the part that a turntable carries; a linear stage; a hand whose pose is given
for every record, as of a robot or a tracker; or no motion."""

if TYPE_CHECKING:
    Carries = str
else:
    Carries = Literal[tuple(MOTIONS)]

PoseFormat = Literal["tum", "wxyz", "matrix", "rotvec", "rpy", "rpy-rad", "abc"]
"""What the numbers of a given pose are, as robots and trackers write them."""
PoseUnit = Literal["m", "mm"]
