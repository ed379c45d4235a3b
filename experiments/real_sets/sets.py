"""Captures of other makers: who made them, where they are, and how the files of a repository become a capture.

    python -m experiments.real_sets.sets NAME FOLDER -o captures/NAME

FOLDER is a copy of the repository, or a bare git snapshot of it. Neither the pictures nor the capture belong to this
project. Pictures are copied as they are: a board's picture without a laser becomes a record's `off`, one with the laser
on its `on`.
"""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

import jaxscan
from experiments.report import command_line


def natural(path: str) -> list[int | str]:
    """A key of sorting that puts Image9 before Image10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]


class Source:
    """One folder or git directory; nothing in it is run."""

    def __init__(self, place: Path) -> None:
        """Remember the place; a git directory is known by its `HEAD` and `objects`."""
        self.place = place
        self.is_git = (place / "HEAD").is_file() and (place / "objects").is_dir()

    def _git(self, *arguments: str) -> bytes:
        command = ["git", f"--git-dir={self.place}", *arguments]
        return subprocess.run(command, capture_output=True, check=True).stdout

    def find(self, folder: str, pattern: str) -> list[str]:
        """Files directly in a folder whose name matches the regular expression, in natural order."""
        if self.is_git:
            # The folder's slash lists what is in it, not the folder.
            names = self._git("ls-tree", "-z", "--name-only", "HEAD", f"{folder}/").decode().split("\0")
        else:
            names = [f"{folder}/{path.name}" for path in (self.place / folder).glob("*")]
        chosen = [name for name in names if re.fullmatch(pattern, name.rsplit("/", 1)[-1])]
        return sorted(chosen, key=natural)

    def read(self, path: str) -> bytes:
        """The bytes of one file."""
        if self.is_git:
            return self._git("cat-file", "blob", f"HEAD:{path}")
        return (self.place / path).read_bytes()


Files = list[dict[str, Any]]
"""Records in which a picture is a path of the repository."""


class RealSet(NamedTuple):
    """One capture of another maker."""

    name: str
    repository: str
    commit: str
    licence: str
    about: str
    header: dict[str, Any]
    """`capture.toml` without the size of the pictures."""
    records: Callable[[Source], Files]
    reference: str = ""
    """Values that the authors published."""
    lens: tuple[str, ...] = ()
    """Options of `jaxscan calibrate` for the lens, as a user who knows it would give them."""
    camera: tuple[float, ...] = ()
    """The camera that the authors calibrated elsewhere: fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    inner_m: float = 0.0
    """For a sweep: radius within which the object covers the table [m]."""
    rig: dict[str, Any] | None = None
    """For a sweep without a calibration: one that is made up, so that the scatter of points alone means something."""


NONE = "no licence stated: measured only"
SRV = ("srv/desktop_3d_scanner", "d7c7b7eca85b3932cb9da7b70983bd3a8bfe580b", NONE)
ZHAO = ("zhaocongyang/structured_LineLight_calib", "672d6417f0ee723e0596a8f0ef03bdb3372768a9", NONE)
HJAMAL = ("hjamal3/Light-Stripe-Calibration", "64ce9a67b32ad91e1f22ece0712a617656685b81", NONE)
STEREO = ("sourishg/stereo-calibration", "257888988de4a1be1012effb41a6a756929f537a", NONE)
FISHEYE = ("sourishg/fisheye-stereo-calibration", "e3074ab16e9768f6df705e91f15dca64b292f85b", NONE)
CICLOP = ("Jesus89/3DScanScience", "29d70ad33084d965d2178730f447ff9aa95acc46", "CC BY-SA 4.0")
ILJA = ("IljaRukin/3D_line_laser_scanner", "ea14966e52bf69f12a6608da70b30c4aa159a118", NONE)
TING = ("tingzhushaohua/binocularLaserScanner", "c4fcca10bd9d7d7ed5fa912edff3d7b4d677716d", NONE)
GOPRO = ("derlunz/opencv-fisheye-calibration-set", "067e45d01f60a964e78c952a6cc4b6ae89203cdc", "GPL-3.0")
OCAM = ("jakarto3d/py-OCamCalib", "2fb7bfdf86f8a723b3a796a972011b537d7c7250", "GPL-2.0")
SONG = (
    "SONG-KUN/A-novel-approach-for-Camera-and-Laser-line-calibration",
    "6a88671a98a622311ea94fd4040df89c18a39cff",
    NONE,
)
OPENCV = ("opencv/opencv", "samples/data", "Apache-2.0")
TORTI = ("AndreaTorti-01/laser-profilometer", "83b1c47635475937d0440ef1e32804781d2931b1", NONE)
ANUGRAH = (
    "Anugrah-T-Sebastian/3D_Scanner_Laser_Triangulation",
    "d2c8a3d36f815e9f37d25b2ac5f31fd2971a710c",
    "GPL-3.0",
)
VATHOS = ("vathos/hand-eye.calibation.demos.vathos.net", "3b0fdc5eb021578272f2988138643592764f8935", "MIT")
EIRIK = ("eirikwha/hand_eye_calibration", "628fef0a3668385940c4c5ce915da5868fd33455", NONE)
XEMA = ("Open3DV/EyeInHand_calibration", "abf75839efd6b25290474596b2f72525e7d8c5e2", NONE)
MOST = 60
"""Boards of one set: more of the same hand-held board say little more and cost minutes."""


def chessboard(columns: int, rows: int, square_mm: float) -> dict[str, Any]:
    """The table of a chessboard with so many inner corners."""
    return {"type": "chessboard", "columns": columns, "rows": rows, "square_mm": square_mm}


def boards(board: dict[str, Any], *, pixel_format: str = "rgb8", **more: Any) -> dict[str, Any]:
    """The header of a calibration."""
    return {"kind": "calibration", "camera": {"pixel_format": pixel_format}, **more, "board": board}


def plain_boards(folder: str, pattern: str, most: int = MOST) -> Callable[[Source], Files]:
    """Pictures of boards without a laser; evenly chosen where there are many."""

    def records(source: Source) -> Files:
        paths = source.find(folder, pattern)
        step = max(1, -(-len(paths) // most))
        return [{"on": None, "off": path} for path in paths[::step]]

    return records


def lit_boards(folder: str, pattern: str) -> Callable[[Source], Files]:
    """Pictures of boards with a laser on, without a picture of the same pose with the laser off."""
    return lambda source: [{"on": path, "off": None} for path in source.find(folder, pattern)]


def pairs(on: tuple[str, str], off: tuple[str, str]) -> Callable[[Source], Files]:
    """Pictures of the same poses with the laser on and off, in the same order."""
    return lambda source: [
        {"on": lit, "off": dark} for lit, dark in zip(source.find(*on), source.find(*off), strict=True)
    ]


def both(*parts: Callable[[Source], Files]) -> Callable[[Source], Files]:
    """Records of several folders."""
    return lambda source: [record for part in parts for record in part(source)]


def turning(folder: str, stem: str, steps: int, step_deg: float) -> Callable[[Source], Files]:
    """A sweep without laser-off pictures."""
    return lambda source: [
        {"angle_deg": k * step_deg, "on": f"{folder}/{stem}{k + 1}.jpg", "off": None} for k in range(steps)
    ]


def posed(
    pictures: tuple[str, str], poses: Callable[[Source, list[str]], np.ndarray], *, board_rides: bool = False
) -> Callable[[Source], Files]:
    """Pictures of one unmoved board with the pose of a robot's hand [pictures, 4, 4], m.

    Args:
        poses: From the pictures' paths.
        board_rides: Whether the camera stands and the hand carries the board: seen from the hand the base moves, so
            the inverse poses are those of the camera's carrier.
    """

    def records(source: Source) -> Files:
        paths = source.find(*pictures)
        hand = poses(source, paths)
        hand = np.linalg.inv(hand) if board_rides else hand
        return [
            {"on": None, "off": path, "angle_deg": None, "placement": 0, "pose": pose[:3].ravel().tolist()}
            for path, pose in zip(paths, hand, strict=True)
        ]

    return records


def _numbers(text: bytes) -> list[float]:
    return [float(one) for one in re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", text.decode())]


def _rigid(turn: Rotation, place: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), place
    return pose


def _vathos(source: Source, paths: list[str]) -> np.ndarray:
    """A line of a name and sixteen numbers each, column after column."""
    rows = source.read("resources/poses.csv").decode().split()
    return np.array([np.reshape([float(one) for one in row.split(",")[1:]], (4, 4)).T for row in rows])


def _xema(source: Source, paths: list[str]) -> np.ndarray:
    """Degrees about the fixed axes x, y and z, and millimetres, a file each."""
    values = np.array([_numbers(source.read(str(Path(path).with_suffix(".txt")))) for path in paths])
    turns = Rotation.from_euler("xyz", values[:, :3], degrees=True)
    return np.array([_rigid(turn, place) for turn, place in zip(turns, values[:, 3:] / 1000.0, strict=True)])


def _eirik(source: Source, paths: list[str]) -> np.ndarray:
    """Metres and a quaternion, its real part last, a file each; the first number is that of YAML's version."""
    poses = [path.replace("/img/img", "/pose/pose").replace(".png", ".yml") for path in paths]
    values = np.array([_numbers(source.read(path))[-7:] for path in poses])
    turns = Rotation.from_quat(values[:, 3:])
    return np.array([_rigid(turn, place) for turn, place in zip(turns, values[:, :3], strict=True)])


def travelling(folder: str, pattern: str, step_m: float) -> Callable[[Source], Files]:
    """A sweep of a linear stage without laser-off pictures."""
    return lambda source: [
        {"position_m": k * step_m, "on": path, "off": None} for k, path in enumerate(source.find(folder, pattern))
    ]


def _green(**more: Any) -> dict[str, Any]:
    return {"laser": [{"colour": "green", **more}]}


DESK = chessboard(8, 6, 40.0)
TABLE = {"kind": "sweep", "camera": {"pixel_format": "rgb8"}, "turntable": {"carries": "object"}, **_green()}
LASER = "python/calib_images/Laser"
CAMERA = "python/calib_images/Camera"

STAGE = {"kind": "sweep", "camera": {"pixel_format": "rgb8"}, "turntable": {"carries": "linear"}}
HAND = {"turntable": {"carries": "poses"}}
PRINTER = {
    "format": "jaxscan-calibration/1",
    "camera": {
        "model": "pinhole",
        "width": 640,
        "height": 480,
        "fx": 900.0,
        "fy": 900.0,
        "cx": 319.5,
        "cy": 239.5,
        "distortion": dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
    },
    "lasers": [{"normal": [0.81915, 0.0, 0.57358], "distance_m": 0.0344148}],
    "turntable": {"carries": "linear", "direction": [1.0, 0.0, 0.0]},
}
"""The bed 60 mm below the camera, where a millimetre of height moves the line by the 10.6 px that its makers found."""

SETS: tuple[RealSet, ...] = (
    RealSet(
        "srv_laser_1707",
        *SRV,
        "desk scanner: a webcam and a green line; a hand-held board with the line on it, nothing with the laser off",
        boards(DESK, **_green()),
        lit_boards(f"{LASER}/Calibracio17_07", r"Image\d+\.jpg"),
        "calibration4.yaml: f 620.27, 618.61, c 322.95, 239.42 px; LaserPlane4.npy: "
        "-0.84630 X - 0.29551 Y + 0.38939 Z + 0.21172 m = 0",
    ),
    RealSet(
        "srv_table",
        *SRV,
        "the same scanner: sweep of 320 steps of 1.125 degrees of the empty table with four ArUco markers "
        "(DICT_4X4_50: 5, 42, 27, 18; 30 mm, centres 90 mm from the axis), nothing with the laser off",
        TABLE,
        turning("python/DataOffline", "step_num_table", 320, 1.125),
    ),
    RealSet(
        "srv_toy",
        *SRV,
        "the same scanner: sweep of a plush toy on the table, the line overexposed, nothing with the laser off",
        TABLE,
        turning("python/DataOffline", "step_num", 320, 1.125),
        inner_m=0.06,
    ),
    RealSet(
        "srv_laser_1207",
        *SRV,
        "the same scanner, other days: 60 boards without laser and 15 dark ones with it, most of them cut off",
        boards(DESK, **_green()),
        both(
            plain_boards(f"{CAMERA}/Calibracio12_07", r"Image\d+\.png"),
            lit_boards(f"{LASER}/CalibracioLaser1207", r"Image\d+\.png"),
        ),
        "calibration2.yaml: f 1372.52, 1371.41, c 968.50, 544.49 px; LaserPlane2.npy: "
        "0.09782 X - 0.08823 Y + 0.95783 Z + 0.25537 m = 0 (cannot be the line of these pictures)",
    ),
    RealSet(
        "hjamal",
        *HJAMAL,
        "camera with oblong pixels and a green line; six pictures of a hand-held sheet of paper with a chessboard, "
        "nothing with the laser off",
        boards(chessboard(6, 8, 40.0), **_green()),
        lit_boards("images", r"\d+_right\.jpg"),
        "calibrate.py: f 514.41, 685.93, c 329.84, 237.71 px, k1 -0.350373, k2 0.158447: taken as known",
        camera=(514.41205, 685.92876, 329.83671, 237.71471, -0.350373, 0.158447, 0.000735, -0.000231, 0.0),
    ),
    RealSet(
        "zhaocongyang",
        *ZHAO,
        "fixed light plane: 12 pairs without and with a red line across a grid of circles",
        boards(
            # The diameter is measured in the pictures.
            {
                "type": "circles",
                "layout": "symmetric",
                "columns": 7,
                "rows": 7,
                "spacing_mm": 37.5,
                "diameter_mm": 22.5,
            },
            laser=[{"colour": "red", "stripe_axis": "columns"}],
        ),
        pairs(("light_picture", r"light\d+\.jpg"), ("calib_picture", r"calib\d+\.jpg")),
        "Parameters.xml: f 1144.44, 1142.49, c 916.06, 522.05 px; -0.13051671 X - 6.3959525 Y + Z + 304.91858 mm = 0",
    ),
    RealSet(
        "ciclop",
        *CICLOP,
        "desk scanner, portrait pictures; boards without laser (those with its lines are too dark to be found)",
        boards(chessboard(11, 6, 13.0)),
        plain_boards("camera", r"frame\d+\.jpg"),
        "notebook 4.2: f 1430.39, 1429.66 px (landscape)",
    ),
    RealSet(
        "srv_boards_1707",
        *SRV,
        "the webcam of srv_laser_1707, hand-held boards without laser",
        boards(DESK),
        plain_boards(f"{CAMERA}/Calibracio17_07", r"Image\d+\.jpg"),
        "calibration4.yaml: f 620.27, 618.61, c 322.95, 239.42 px",
    ),
    RealSet(
        "srv_matlab",
        *SRV,
        "the same scanner's camera at 1920 x 1080, hand-held boards for Matlab's calibrator",
        boards(DESK),
        plain_boards("camera_calibration", r"Image\d+\.png"),
        "calibration.yaml: f 1395.63, 1393.69, c 970.80, 532.54 px (perhaps of other pictures)",
    ),
    RealSet(
        "stereo_left",
        *STEREO,
        "left webcam of a stereo rig, hand-held board",
        boards(chessboard(9, 6, 24.23)),
        plain_boards("calib_imgs/1", r"left\d+\.jpg"),
    ),
    RealSet(
        "stereo_right",
        *STEREO,
        "right webcam of the same stereo rig, same board",
        boards(chessboard(9, 6, 24.23)),
        plain_boards("calib_imgs/1", r"right\d+\.jpg"),
    ),
    RealSet(
        "fisheye_left",
        *FISHEYE,
        "left camera of a stereo rig with fisheye lenses",
        boards(chessboard(9, 6, 24.23)),
        plain_boards("imgs", r"left\d+\.jpg"),
        lens=("--lens", "fisheye"),
    ),
    RealSet(
        "fisheye_right",
        *FISHEYE,
        "right camera of the same rig",
        boards(chessboard(9, 6, 24.23)),
        plain_boards("imgs", r"right\d+\.jpg"),
        lens=("--lens", "fisheye"),
    ),
    RealSet(
        "ilja",
        *ILJA,
        "a Raspberry Pi's camera, hand-held chessboard of a printed page (side of a square assumed)",
        boards(chessboard(9, 6, 25.0)),
        plain_boards("rectification/images", r"image\d+\.jpg"),
    ),
    *(
        RealSet(
            f"ting_{side.lower()}",
            *TING,
            f"{side.lower()} camera of a scanner with two cameras and a turning laser (side of a square assumed)",
            boards(chessboard(9, 6, 30.0), pixel_format="mono8"),
            plain_boards("SystemCalibration/testPic", rf"{side}\d+\.jpg"),
        )
        for side in ("Left", "Right")
    ),
    RealSet(
        "gopro",
        *GOPRO,
        "a GoPro Hero 3+, published because OpenCV's fisheye solve fails on it",
        boards(chessboard(15, 9, 26.0), pixel_format="mono8"),
        plain_boards(".", r"3D_L\d+\.JPG"),
        lens=("--lens", "fisheye"),
    ),
    *(
        RealSet(
            f"ocam_{number}",
            *OCAM,
            f"fisheye lens {number} of Scaramuzza's toolbox: grey, boards up to the rim",
            boards(chessboard(8, 6, side_mm), pixel_format=pixels),
            plain_boards(f"test_images/fish_{number}", r"Fisheye\d_\d+\.jpg"),
            lens=("--lens", "fisheye"),
        )
        for number, side_mm, pixels in ((1, 32.5, "rgb8"), (2, 117.0, "mono8"))
    ),
    RealSet(
        "songkun",
        *SONG,
        "rendered, not photographed: a dark board with a blue line, after 30 boards without one",
        boards(chessboard(11, 6, 60.0), laser=[{"colour": "blue", "stripe_axis": "columns"}]),
        both(
            plain_boards("cameraIntrinsic/intrinsic_imageSet", r"intrinsic\d+\.png"),
            lit_boards("calibrationSystem", r"systemCalibration\d+\.png"),
        ),
    ),
    RealSet(
        "opencv_left",
        *OPENCV,
        "left camera of OpenCV's stereo samples",
        boards(chessboard(9, 6, 25.0), pixel_format="mono8"),
        plain_boards(".", r"left\d+\.jpg"),
        "left_intrinsics.yml: 0.3926 px",
    ),
    RealSet(
        "torti",
        *TORTI,
        "rendered, not photographed, and dark: 11 boards with a blue line, and 30 without",
        boards(chessboard(11, 6, 24.0), laser=[{"colour": "blue", "stripe_axis": "columns"}]),
        both(
            plain_boards("log_reconstruction/camera_calibration", r"intrinseci\d+\.png"),
            lit_boards("log_reconstruction/laser_plane_calibration", r"systemCalibration\d+\.png"),
        ),
    ),
    RealSet(
        "anugrah_boards",
        *ANUGRAH,
        "a camera on the head of a 3D printer: 11 boards that lie flat on its bed (side of a square assumed)",
        boards(chessboard(5, 5, 4.0)),
        plain_boards("Calibration", r"Snap_\d+\.jpg"),
        "Values.txt: f 6295.31, 6361.34, c 331.14, 273.24 px, k1 19.2, k2 -6308",
    ),
    *(
        RealSet(
            f"anugrah_{name}",
            *ANUGRAH,
            f"the same camera and a red line, overexposed: sweep of 65 steps of 1 mm {over}, never off",
            {**STAGE, "laser": [{"colour": "red"}]},
            travelling(f"Measured_steps_Data/{folder}", r"StillSnapshot\d+\.jpg", 1e-3),
            rig=PRINTER,
        )
        for name, folder, over in (
            ("bed", "05.08.24.Reference_Scan", "over the empty bed"),
            ("pyramid", "05.08_Pyramid", "over a pyramid"),
            ("cube", "1mmscan_cube", "over a cube"),
        )
    ),
    RealSet(
        "vathos",
        *VATHOS,
        "a camera on the hand of a robot: 10 poses round one board",
        boards(chessboard(10, 7, 25.0), **HAND),
        posed(("resources", r"img_\d+\.png"), _vathos),
        "main.py: f 1759.16, 1764.07, c 962.83, 595.89 px",
    ),
    RealSet(
        "xema",
        *XEMA,
        "a camera on the hand of a robot: 8 poses, hardly tilted, over a small grid of white circles on black",
        boards(
            {
                "type": "circles",
                "layout": "asymmetric",
                "columns": 7,
                "rows": 11,
                "spacing_mm": 10.0,
                "diameter_mm": 8.0,
            },
            pixel_format="mono8",
            **HAND,
        ),
        posed(("input_EyeInHand", r"pos\d+\.bmp"), _xema),
        "param.txt: f 2069.9, 2069.45, c 955.28, 588.69 px",
        camera=(2069.9, 2069.45, 955.283, 588.688, -0.0450238, -0.00447247, 0.00013755, -0.000281302, 0.866311),
    ),
    RealSet(
        "eirik",
        *EIRIK,
        "a camera that stands still, the board on the hand of a robot: 19 poses",
        boards(chessboard(9, 7, 10.0), **HAND),
        posed(("data/calib080419/img", r"img\d+\.png"), _eirik, board_rides=True),
        "intrinsics.yml of the other day: f 2743.81, 2747.97, c 934.08, 623.99 px",
    ),
)
BY_NAME = {one.name: one for one in SETS}


def convert(one: RealSet, source: Source, folder: Path) -> int:
    """Write the capture."""
    records = one.records(source)
    if not records:
        raise SystemExit(f"{source.place}: no pictures of {one.name} found, expected a copy of {one.repository}")
    folder.mkdir(parents=True)
    size: dict[str, int] = {}
    lines = []
    for k, record in enumerate(records):
        written = {"i": k, **record}
        for which in ("on", "off"):
            path = record[which]
            if path is None:
                continue
            data = source.read(path)
            # The size of the first picture; a picture of another size is refused by whoever reads the capture.
            size = size or _size(data)
            name = f"{which}/{k:06d}{Path(path).suffix}"
            (folder / which).mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
            written[which] = name
        lines.append(json.dumps(written))
    (folder / "frames.jsonl").write_text("\n".join(lines) + "\n")
    camera = {**size, **one.header["camera"]}
    origin = {
        "repository": one.repository,
        "commit": one.commit,
        "licence": one.licence,
        "about": one.about,
    }
    header = {"format": "jaxscan-capture/1", **one.header, "camera": camera, "acquisition": origin}
    (folder / "capture.toml").write_text(tomli_w.dumps(header))
    return len(records)


def _size(data: bytes) -> dict[str, int]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return {"width": picture.shape[1], "height": picture.shape[0]}


def main() -> int:
    """Convert one set."""
    parser = command_line(__doc__)
    parser.add_argument("name", choices=sorted(BY_NAME))
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    partial = options.output.with_name(f"{options.output.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    count = convert(BY_NAME[options.name], Source(options.folder), partial)
    partial.rename(options.output)
    try:
        jaxscan.open_capture(options.output)
    except jaxscan.JaxscanError as problem:
        print(f"note: {problem}")
    print(f"{options.output}: {count} records of {options.name}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
