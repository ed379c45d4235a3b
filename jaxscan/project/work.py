"""One step done in one process: its workspace, and the work of each kind."""

import contextlib
import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import jaxscan
from jaxscan import api
from jaxscan.api.recalibration import turned
from jaxscan.calibration import Calibration
from jaxscan.drawing import Sheet, draw_plan, survey_room
from jaxscan.errors import CalibrationError, CaptureError, CloudError, GivenError, JaxscanError, MeasurementError
from jaxscan.files.calibration import calibration_digest, calibration_notes
from jaxscan.files.capture import Capture, open_capture
from jaxscan.files.clouds import save_stations
from jaxscan.files.disk import (
    MEGABYTE,
    file_digest,
    make_folder,
    parse_json,
    partial_folder,
    read_bounded,
    refuse_links,
    reported,
    write_atomically,
)
from jaxscan.files.known_room import load_known_room
from jaxscan.geometry import Scanner
from jaxscan.measurement import RoomBox, measure_room
from jaxscan.project.catalogue import Output, Row
from jaxscan.project.steps import Status, Step
from jaxscan.recalibration import Recalibration
from jaxscan.reconstruction import PointCloud, Progress, join_clouds, stack_placed


@dataclass(frozen=True)
class StepWorkspace:
    """The files that one step reads, and a folder for what it writes."""

    step: Step
    output: Path
    """The folder of the products."""
    folder: Path
    """Temporary folder; its files are moved to their places when all are complete."""
    progress: Progress
    """Called with (done, in all)."""
    notes: list[str] = field(default_factory=list)
    """Remarks for the user, a sentence each."""

    def capture(self, role: str = "capture") -> Capture:
        """A capture. Its stripes are kept among the products: nothing is written into its own folder."""
        kept = self.output / "stripes"
        _make(self.output, kept)
        # Named as in the project: the folders of two captures may have the same name.
        place = -1 if self.step.kind == "station" else 1
        name = role.removeprefix("capture ") if role.startswith("capture ") else self.step.key.split("/")[place]
        capture = open_capture(self.step.sources[role]).keeping(kept / f"{name}.npz")
        self.notes.extend(capture.notes)
        return capture

    def file(self, role: str) -> Path:
        """A file that a step before made, or that was given."""
        if role in self.step.products:
            path = self.output / self.step.products[role]
            with reported(f"{path}: cannot be read", error=CaptureError):
                refuse_links(self.output, path)
            return path
        return Path(self.step.sources[role])

    def target(self, number: int = 0) -> Path:
        """Temporary path of an output of the step."""
        return self.beside(self.step.outputs[number])

    def beside(self, output: str) -> Path:
        """Temporary path of a file that becomes `output` among the products."""
        path = self.folder / "made" / output
        make_folder(path.parent, own=self.folder)
        return path

    def made(self) -> list[str]:
        """All that was written so far, by its place among the products."""
        made = self.folder / "made"
        return sorted(str(path.relative_to(made)) for path in made.rglob("*") if path.is_file())

    def setting(self, name: str) -> Any:
        """A setting of the step."""
        return self.step.settings[name]

    def sweep(self) -> Capture:
        """The records of the step's capture that are wanted."""
        return self.capture().every(self.setting("every"))

    def scanner(self) -> Scanner:
        """The rig of the step's calibration."""
        return api.load_scanner(self.file("calibration"))

    def cloud(self) -> PointCloud:
        """The cloud that a step before made."""
        return api.load_cloud(self.file("cloud"))

    def digest(self) -> str:
        """Digest of the step's calibration."""
        return calibration_digest(self.file("calibration"))


def calibrate_rig(workspace: StepWorkspace) -> None:
    """Calibrate from captures of a board, as `jaxscan calibrate` does.

    Raises:
        CalibrationError: If the result cannot be used.
    """
    captures = [workspace.capture(role) for role in workspace.step.sources]
    boards = " and ".join(Path(address).name for address in workspace.step.sources.values())
    try:
        result = api.calibrate(captures, progress=workspace.progress)
    except CalibrationError as problem:
        raise CalibrationError(f"{boards}: {problem}") from problem
    verdict = result.quality.verdict
    if verdict is not None and verdict.refused is not None:
        raise CalibrationError(f"{boards}: cannot be used: {verdict.refused}")
    good_to = verdict.good_to if verdict is not None else None
    if good_to is not None and good_to.sigma_mm is not None and good_to.at_m is not None:
        length = f" for {good_to.length_m:.2g} m" if good_to.length_m is not None else ""
        workspace.notes.append(f"Good to {good_to.sigma_mm:.2g} mm{length} at {good_to.at_m:.1f} m.")
    workspace.notes.extend(result.missing)
    api.save_calibration(result, workspace.target())


def reconstruct_sweep(workspace: StepWorkspace) -> None:
    """Reconstruct a sweep, as `jaxscan reconstruct` does, in all formats that are wanted."""
    workspace.notes.extend(calibration_notes(workspace.file("calibration")))
    sweep, scanner, settings = workspace.sweep(), workspace.scanner(), reconstruct_settings(workspace)
    done = api.reconstruct_capture(sweep, scanner, settings=settings, progress=workspace.progress)
    workspace.notes.extend(done.notes)
    cloud = coloured(workspace, done.cloud, sweep, scanner)
    for number in range(len(workspace.step.outputs)):
        api.save_cloud(cloud, workspace.target(number), calibration_digest=workspace.digest())


def measure(workspace: StepWorkspace) -> None:
    """The lengths of the room, and how good its points are, as JSON; two versions or epochs are compared by them."""
    cloud, scanner = workspace.cloud(), workspace.scanner()
    valid = np.asarray(cloud.valid)
    found: dict[str, Any] = {"format": MEASURES_FORMAT, "points": int(valid.sum())}
    for name in ("sigma_random", "sigma_systematic"):
        found[f"median_{name}_m"] = float(np.median(np.asarray(getattr(cloud, name))[valid]))
    try:
        found["lengths"] = _lengths(measure_room(cloud, scanner=scanner))
    except MeasurementError as problem:
        # A sweep of something other than a room has no lengths of a room.
        found["lengths"] = {}
        workspace.notes.append(str(problem))
    text = json.dumps(found, indent=2, allow_nan=False) + "\n"
    write_atomically(workspace.target(), text.encode())


def make_mesh(workspace: StepWorkspace) -> None:
    """The mesh of a cloud, in its colours."""
    api.save_mesh(api.mesh_cloud(workspace.cloud(), scanner=workspace.scanner()), workspace.target())


def draw_room(workspace: StepWorkspace) -> None:
    """The plan of a room, a metre above its floor."""
    drawing = draw_plan(survey_room(workspace.cloud(), scanner=workspace.scanner()), sheet=_sheet(workspace))
    for number in range(len(workspace.step.outputs)):
        api.save_drawing(drawing, workspace.target(number))


def _sheet(workspace: StepWorkspace) -> Sheet:
    """The title block: the project's name, the room's, and the day on which its first capture was begun."""
    started = open_capture(workspace.step.sources["capture"], compare=False).header.acquisition.get("started")
    room, day = workspace.step.key.split("/")[-1], started[:10] if isinstance(started, str) else ""
    return Sheet(project=workspace.setting("project"), room=room, date=day)


def draw_panorama(workspace: StepWorkspace) -> None:
    """The panorama of a sweep, with depths and normals."""
    sweep, scanner = workspace.sweep(), workspace.scanner()
    drawn = api.draw_panorama(sweep, scanner, cloud=workspace.cloud(), progress=workspace.progress)
    api.save_panorama(drawn, workspace.target())


def write_report(workspace: StepWorkspace) -> None:
    """The report of a cloud."""
    # Imported here, because it loads matplotlib.
    from jaxscan.api.reports import report_files

    report_files(workspace.file("cloud"), workspace.file("calibration"), workspace.target())


def register_stations(workspace: StepWorkspace) -> None:
    """The places of all stations and a calibration that fits them all, in one least squares.

    Where the sweeps gain nothing over the calibration they were given, that one is kept; the places are good anyhow.

    Raises:
        CalibrationError: If it did not converge.
    """
    names, result = workspace.setting("captures"), _recalibrated(workspace)
    adjusted = result.adjusted
    if not adjusted.converged:
        raise CalibrationError(f"{workspace.step.key}: the places of the stations were not found: {result.refused}")
    workspace.notes.extend(result.notes)
    _save(workspace, result.calibration, result.refused)
    for number, name in enumerate(names):
        worst = float(np.sqrt(np.linalg.eigvalsh(adjusted.station_covariance[number][:3, :3])[-1]))
        if worst > VAGUE_M:
            workspace.notes.append(
                f"The sweeps determine the place of {name} only to {1e3 * worst:.0f} mm in some direction."
            )
    stations = [
        {
            "capture": name,
            "pose": adjusted.stations[number].tolist(),
            "covariance": adjusted.station_covariance[number].tolist(),
            "corrections_rad": np.asarray(adjusted.corrections[number]).tolist(),
        }
        for number, name in enumerate(names)
    ]
    write_atomically(workspace.target(1), json.dumps({"format": STATIONS_FORMAT, "stations": stations}).encode())


def refine_rig(workspace: StepWorkspace) -> None:
    """The calibration of a rig, refined by the sweeps of one room.

    It is unchanged where they add nothing, or cannot be used: then the other rooms still refine it.

    Raises:
        GivenError: If a known length or place contradicts the sweeps.
    """
    calibration, refused = None, None
    try:
        result = _recalibrated(workspace)
        calibration, refused = result.calibration, result.refused
        workspace.notes.extend(result.notes)
    except GivenError:
        # The user can correct this; going on with the stored calibration would hide it.
        raise
    except (CalibrationError, CaptureError) as problem:
        refused = str(problem)
    _save(workspace, calibration, refused)


def place_station(workspace: StepWorkspace) -> None:
    """The cloud of one station, in the frame of the group."""
    stations = workspace.file("stations")
    text = read_bounded(stations, _MOST_BYTES, error=CloudError)
    station = parse_json(text, name=str(stations), error=CloudError)["stations"][workspace.setting("number")]
    sweep, scanner = workspace.sweep(), workspace.scanner()
    settings, right = reconstruct_settings(workspace), turned(sweep, np.array(station["corrections_rad"]))
    done = api.reconstruct_capture(right, scanner, settings=settings, progress=workspace.progress)
    workspace.notes.extend(done.notes)
    cloud = coloured(workspace, done.cloud, sweep, scanner)
    placed = join_clouds([cloud], [np.array(station["pose"])], [np.array(station["covariance"])])
    api.save_cloud(placed, workspace.target(), calibration_digest=workspace.digest())


def merge_e57(workspace: StepWorkspace) -> None:
    """One E57 with a scan and its pose for each station."""
    roles = [role for role in workspace.step.products if role.startswith("cloud ")]
    loads = [partial(api.load_cloud, workspace.file(role)) for role in roles]
    save_stations(loads, workspace.target(), calibration_digest=workspace.digest())


def merge_plan(workspace: StepWorkspace) -> None:
    """One plan from the points of all stations."""
    points = sum(int(np.asarray(cloud.valid).sum()) for cloud in _clouds(workspace))
    every = max(1, -(-points // PLAN_POINTS))
    # Thinned one by one, so that the whole is never in memory.
    placed = stack_placed([stack_placed([cloud], every=every) for cloud in _clouds(workspace)])
    drawing = draw_plan(survey_room(placed, scanner=workspace.scanner()), sheet=_sheet(workspace))
    api.save_drawing(drawing, workspace.target())


WORK: Mapping[str, Callable[[StepWorkspace], None]] = {
    "calibration": calibrate_rig,
    "recalibration": refine_rig,
    "cloud": reconstruct_sweep,
    "measures": measure,
    "mesh": make_mesh,
    "plan": draw_room,
    "panorama": draw_panorama,
    "report": write_report,
    "register": register_stations,
    "station": place_station,
    "merged e57": merge_e57,
    "merged plan": merge_plan,
}
"""The function for each kind of step."""
_LONGEST = 2000


def do_step(status: Status, output: Path, progress: Progress = None) -> Row:
    """Do one step, and say how it went: no error leaves, so one failed capture does not stop the others.

    Args:
        status: The step.
        output: The folder of the products.
        progress: Called with (done, in all).
    """
    started = time.perf_counter()
    try:
        outputs, notes = _done(status.step, output, progress)
    except JaxscanError as problem:
        return failed_row(status, str(problem), seconds=time.perf_counter() - started)
    except Exception as problem:
        # A defect of jaxscan is the failure of one step too; where it arose is kept in the catalogue.
        message = f"unexpected {type(problem).__name__}: {problem}".splitlines()[0]
        return failed_row(status, message, seconds=time.perf_counter() - started, details=traceback.format_exc())
    return _row(status, "done", _sentences(notes), time.perf_counter() - started)._replace(outputs=outputs)


def _sentences(notes: Sequence[str]) -> str:
    """Notes in one line, each with its full stop."""
    return " ".join(note if note.endswith((".", "!", "?")) else f"{note}." for note in map(str.strip, notes) if note)


def begun_row(status: Status) -> Row:
    """The row of a step that is begun now."""
    return _row(status, "begun", "", 0.0)


def failed_row(status: Status, message: str, *, seconds: float = 0.0, details: str = "") -> Row:
    """The row of a step that failed now, after some time, with the line that says why."""
    return _row(status, "failed", message, seconds)._replace(details=details)


def _row(status: Status, state: str, message: str, seconds: float) -> Row:
    return Row(
        status.step.key,
        status.digest,
        state,
        message[:_LONGEST],
        status.parts,
        (),
        started_s=time.time() - seconds,
        seconds=seconds,
        host=f"{platform.node()} {os.getpid()}",
        version=jaxscan.__version__,
    )


def _done(step: Step, output: Path, progress: Progress) -> tuple[tuple[Output, ...], list[str]]:
    """What a step wrote, and its notes. Its folder is removed at the end; that of a killed process by the next one."""
    with contextlib.ExitStack() as stack:
        with reported(f"{output}: cannot be written", error=CaptureError):
            folder = stack.enter_context(partial_folder(output / "step"))
        workspace = StepWorkspace(step, output, folder, progress)
        WORK[step.kind](workspace)
        made = workspace.made()
        missing = next((name for name in step.outputs if name not in made), None)
        if missing is not None:
            raise CaptureError(f"{step.key}: {missing} was not written.")
        files = {path: workspace.beside(path) for path in made}
        written = tuple(Output(path, file.stat().st_size, file_digest(file)) for path, file in files.items())
        publish(workspace)
        return written, workspace.notes


def publish(workspace: StepWorkspace) -> None:
    """Give all that was written its place among the products; each file is there whole or not at all."""
    for path in workspace.made():
        target = workspace.output / path
        _make(workspace.output, target.parent)
        workspace.beside(path).replace(target)


def _make(own: Path, folder: Path) -> None:
    with reported(f"{folder}: cannot be written", error=CaptureError):
        make_folder(folder, own=own)


def reconstruct_settings(workspace: StepWorkspace) -> api.ReconstructSettings:
    """Settings of the reconstruction of a step's sweep."""
    return api.ReconstructSettings(
        smooth=workspace.setting("smooth"),
        min_range_m=workspace.setting("min_range_m"),
        max_range_m=workspace.setting("max_range_m"),
    )


def coloured(workspace: StepWorkspace, cloud: PointCloud, sweep: Capture, scanner: Scanner) -> PointCloud:
    """The cloud in the colours that are wanted, as far as there are photographs."""
    if workspace.setting("colour") != "photographs" or not api.has_photographs(sweep):
        return cloud
    return api.colour_cloud(cloud, sweep, scanner)


MEASURES_FORMAT = "jaxscan-measures/1"


def _lengths(box: RoomBox) -> dict[str, Any]:
    fields = ("value_m", "sigma_m", "sigma_random_m", "sigma_systematic_m")
    return {name: {field: getattr(side, field) for field in fields} for name, side in box.sides.items()}


STATIONS_FORMAT = "jaxscan-stations/1"
PLAN_POINTS = 20_000_000
"""Points that the plan of a group is drawn from; of more, only every n-th profile."""
VAGUE_M = 0.02
"""A note is given for a station whose place has a larger standard deviation [m]."""
_MOST_BYTES = 64 * MEGABYTE


def _recalibrated(workspace: StepWorkspace) -> Recalibration:
    pairs = list(zip(workspace.setting("captures"), workspace.setting("every"), strict=True))
    captures = [workspace.capture(f"capture {name}").every(every) for name, every in pairs]
    given = load_known_room(workspace.file("known")) if "known" in workspace.step.sources else None
    settings = api.RecalibrationSettings(stations=len(captures) > 1)
    return api.recalibrate(
        captures, workspace.file("calibration"), given=given, settings=settings, progress=workspace.progress
    )


def _save(workspace: StepWorkspace, calibration: Calibration | None, refused: str | None) -> None:
    """Write a new calibration; where there is none, that which was given, and a note why."""
    if calibration is None:
        workspace.notes.append(f"The calibration is as it was: {refused}")
        stored = read_bounded(workspace.file("calibration"), _MOST_BYTES, error=CalibrationError)
        write_atomically(workspace.target(0), stored)
    else:
        api.save_calibration(calibration, workspace.target(0))


def _clouds(workspace: StepWorkspace) -> Iterator[PointCloud]:
    """The clouds of the stations, one after the other."""
    for role in workspace.step.products:
        if role.startswith("cloud "):
            yield api.load_cloud(workspace.file(role))
