"""The three sessions that a page may ask for: to look, to sweep, and to capture the board."""

import math
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxscan
from jaxscan import api
from jaxscan.cli.boards import CommandOperator, make_guide
from jaxscan.cli.console.boards import PageOperator, on_board_pair
from jaxscan.cli.console.captures import verdict_of
from jaxscan.cli.console.desk import Desk, Running, progress_of
from jaxscan.cli.console.painter import Seen
from jaxscan.cli.console.works import Work, Works
from jaxscan.cli.live import LiveCloud
from jaxscan.cli.scan_display import ScanPlan, sweep_header
from jaxscan.errors import CaptureError, JaxscanError, OptionError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import HEADER_NAME


if TYPE_CHECKING:
    from scanrig.doctor import Finding
    from scanrig.session import PlacementRequest, Sight

_GOOD_ENOUGH, _AUTO_STEP, _SHORTEST_MS, _LONGEST_MS = 0.12, 4.0, 0.05, 2000.0
"""How near to the best exposure "auto" ends, its largest step, and its limits."""
_ENOUGH_PLACEMENTS = 2
"""Standing places after which a calibration is tried while others follow."""


class Sessions:
    """The sessions of a desk, and the works that follow them."""

    def __init__(self, desk: Desk, works: Works, calibration: Path | None) -> None:
        """Give the desk its sessions."""
        self._desk, self._works = desk, works
        self._slate, self._captures = desk.slate, desk.captures
        self.calibration = calibration
        """With which clouds are made; the last good one."""
        desk.after = self.list
        desk.sessions = {"aim": self.aim, "sweep": self.sweep, "boards": self.boards}

    def aim(self, running: Running) -> str:
        """Show the camera's picture with the laser's line, and how to expose."""
        from scanrig.config import with_exposure
        from scanrig.doctor import judge_exposure
        from scanrig.session import Hooks, run_aiming

        def see(sight: "Sight") -> None:
            facts: dict[str, Any] = {"angle_deg": round(sight.angle_deg, 3), "proof": "", "dark": sight.pair is None}
            if sight.pair is None or sight.proof is None:
                running.painter.show(Seen(None, sight.off, 0, facts))
                return
            facts["proof"] = "" if sight.proof.ok else sight.proof.reason
            wish = self._desk.wish()
            ms = running.rig.camera.exposure_ms if wish.exposure_ms is None else wish.exposure_ms
            gain = running.rig.camera.gain_db if wish.gain_db is None else wish.gain_db
            found = judge_exposure(sight.pair, sight.proof, with_exposure(running.rig, ms, gain))
            if sight.proof.ok:
                facts["exposure"] = {"verdict": found.verdict, "found": found.found, "do": found.do}
            running.painter.show(Seen(sight.on, sight.off, sight.pair.laser, facts))
            self._expose_better(found, ms, gain)

        hooks = Hooks(notify=self._desk.notify, should_stop=running.should_stop)
        return run_aiming(running.rig, running.devices, see, hooks, self._desk.wish)

    def _expose_better(self, found: "Finding", exposure_ms: float, gain_db: float) -> None:
        """One step of "auto": the exposure with which the line would be as bright as it should be."""
        desk, factor = self._desk, found.values["factor"]
        if desk.auto <= 0:
            return
        desk.auto -= 1
        clear = found.values["clipped"] == 0 and found.values["peak_dn"] > 0
        if clear and abs(factor - 1) < _GOOD_ENOUGH:
            desk.auto = 0
            self._slate.say(f"Auto: the exposure is {exposure_ms:.3g} ms; {found.found}.")
        low, high = 1 / _AUTO_STEP, _AUTO_STEP
        better = float(min(max(exposure_ms * min(max(factor, low), high), _SHORTEST_MS), _LONGEST_MS))
        if desk.auto > 0:
            desk.expose(float(f"{better:.3g}"), gain_db)
        elif not (clear and abs(factor - 1) < _GOOD_ENOUGH):
            self._slate.say(f"Auto: found no better exposure than {exposure_ms:.3g} ms; {found.found}.", "problem")

    def sweep(self, running: Running) -> str:
        """Take a sweep; with a calibration the cloud grows meanwhile, and is written at the end."""
        from scanrig.session import Hooks, run_sweep

        rig, order = running.rig, running.order
        folder = self._captures.path(order.name)
        plan = ScanPlan.of(rig, boards=False)
        self._expect(running, plan)
        with ExitStack() as stack:
            live = None if self.calibration is None else stack.enter_context(self._live(running, plan, folder))

            def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
                facts = {"record": number, "angle_deg": round(math.degrees(angle), 3)}
                running.painter.show(Seen(on, off, rig.laser_of(number), facts))
                if live is not None:
                    live.add(number, angle, on, off)
                    self._slate.write(cloud=live.status()._asdict())

            progress = progress_of(self._slate, time.monotonic, plan.seconds)
            result = run_sweep(
                rig,
                folder,
                running.devices,
                Hooks(on_pair, progress, self._desk.notify, running.should_stop),
                resume=order.resume,
                calibration_digest=None if self.calibration is None else calibration_digest(self.calibration),
            )
        if result.status == "complete" and self.calibration is not None:
            self.reconstruct(order.name)
        return str(result.message)

    def boards(self, running: Running) -> str:
        """Capture the board; a calibration is tried as soon as one is possible."""
        from scanrig.session import Hooks, run_calibration

        rig, order, desk = running.rig, running.order, self._desk
        if rig.board is None:
            raise OptionError(f"{desk.chosen.config}: has no [board] table, which captures of boards need.")
        folder = self._captures.path(order.name)
        plan, by_hand = ScanPlan.of(rig, boards=True), desk.chosen.place_command is None
        self._expect(running, plan, by_hand=by_hand)
        guide = make_guide(rig)
        operator = PageOperator(guide, running.painter, self._slate, running.should_stop)
        if desk.chosen.place_command is not None:
            free = rig.calibration.free_views
            operator.command = CommandOperator(desk.chosen.place_command, free_views=free, console=desk.out)

        def try_calibration(request: "PlacementRequest") -> None:
            if request.kind == "placement" and request.number >= _ENOUGH_PLACEMENTS and not self._works.busy:
                self.calibrate(order.name, "the poses so far")

        operator.before = try_calibration
        desk.operator = operator
        try:
            on_pair = on_board_pair(rig, guide, operator, running.painter, self._slate)
            progress = progress_of(self._slate, time.monotonic, None if by_hand else plan.seconds, plan.work)
            hooks = Hooks(on_pair, progress, desk.notify, running.should_stop)
            result = run_calibration(rig, folder, running.devices, operator, hooks, resume=order.resume)
        finally:
            desk.operator = None
            self._slate.write(placing=None)
        if result.status == "complete":
            self.calibrate(order.name)
        return str(result.message)

    def calibrate(self, name: str, of: str = "") -> None:
        """Calibrate from a capture of the board; a good calibration is used from then on.

        Args:
            name: The capture.
            of: Of which part of it, as pages name it.
        """
        file = self._captures.calibration(name)
        words = ["calibrate", str(self._captures.path(name)), "-o", str(file)]
        self._works.begin(Work(f"calibrate {name}" + (f", {of}" if of else ""), words, self._judged(name, file)))

    def recalibrate(self, name: str) -> None:
        """Better the calibration by a sweep of a room; the new one is used from then on.

        Raises:
            OptionError: If there is no calibration.
        """
        old, file = self._needed(), self._captures.path(name).with_name(f"{name}.recalibrated.json")
        words = ["recalibrate", str(self._captures.path(name)), "-c", str(old), "-o", str(file)]
        self._works.begin(Work(f"recalibrate {name}", words, self._judged(name, file)))

    def _judged(self, name: str, file: Path) -> Callable[[bool, dict[str, Any]], None]:
        """What follows a calibration: its verdict is shown, and a good one is used."""

        def then(well: bool, result: dict[str, Any]) -> None:
            if well:
                self.take(file)
            elif result:
                self._slate.write(verdict={"capture": name, "well": False} | _refused(result))
            self.list()

        return then

    def use(self, file: str) -> None:
        """Make clouds with another calibration of those that are listed.

        Raises:
            OptionError: If it is none of them, or may not be used.
        """
        found = next((one for one in self._captures.calibrations() if one["file"] == file), None)
        if found is None or not found["good"]:
            raise OptionError(f"{file}: is no calibration of this rig that may be used.")
        self.take(self._captures.folder_of(found) / file)
        self.list()

    def take(self, file: Path) -> None:
        """Make clouds with a calibration from now on, and show its verdict."""
        self.calibration = file
        self._slate.write(calibration=str(file), verdict={"well": True} | verdict_of(api.load_calibration(file)))

    def _needed(self) -> Path:
        if self.calibration is None:
            raise OptionError("there is no calibration yet: capture the board first, or begin with --calibration.")
        return self.calibration

    def reconstruct(self, name: str) -> None:
        """Make the cloud of a sweep.

        Raises:
            OptionError: If there is no calibration.
        """
        self._make("reconstruct", name, self._captures.cloud(name), ["-c", str(self._needed())], of=None)

    def draw_plan(self, name: str) -> None:
        """Draw the plan of a cloud."""
        self._make("plan", name, self._captures.made(name, "plan"), self._known())

    def make_mesh(self, name: str) -> None:
        """Make the mesh of a cloud, with the photographs of its capture on it."""
        texture = ["--texture", str(self._captures.path(name)), "-c", str(self._needed())]
        self._make("mesh", name, self._captures.made(name, "mesh"), texture)

    def report(self, name: str) -> None:
        """Write the report on a cloud."""
        self._make("report", name, self._captures.made(name, "report"), [])

    def _known(self) -> list[str]:
        return [] if self.calibration is None else ["-c", str(self.calibration)]

    def _make(self, verb: str, name: str, to: Path, options: list[str], of: str | None = "cloud") -> None:
        """Begin a verb that makes something of a capture, or of its cloud."""
        source = self._captures.path(name) if of is None else self._captures.cloud(name)
        words = [verb, str(source), *options, "-o", str(to)]
        self._works.begin(Work(f"{verb} {name}", words, lambda well, result: self.list()))

    def delete(self, name: str) -> None:
        """Remove a capture and what was made of it.

        Raises:
            OptionError: If something is done with it.
        """
        self._require_idle()
        self._captures.delete(name)
        self._slate.say(f"{name} was deleted.")
        self.list()

    def rename(self, name: str, other: str) -> None:
        """Give a capture and what was made of it another name.

        Raises:
            OptionError: If something is done with it.
        """
        self._require_idle()
        self._captures.rename(name, other)
        self._slate.say(f"{name} is called {other} now.")
        self.list()

    def _require_idle(self) -> None:
        # Not while somebody looks either: large folders take a while, and Stop would wait.
        if self._slate.read("doing") != "nothing" or self._works.busy:
            raise OptionError("something is captured or calculated: wait until it is done.")

    def compare(self, name: str, other: str) -> None:
        """Compare two clouds."""
        words = ["measure", "compare", str(self._captures.cloud(name)), str(self._captures.cloud(other))]
        self._works.begin(Work(f"compare {name} with {other}", words))

    def list(self) -> None:
        """Show the captures in the folder, and the space that is left."""
        from scanrig.recording import free_bytes

        folder = self._captures.folder.absolute()
        there = next(path for path in (folder, *folder.parents) if path.exists())
        digest = ""
        # A file that is gone makes no cloud old.
        if self.calibration is not None:
            with suppress(JaxscanError):
                digest = calibration_digest(self.calibration)
        self._slate.write(
            captures=self._captures.listed(),
            calibrations=self._captures.calibrations(),
            calibration_digest=digest,
            free_bytes=free_bytes(there),
        )

    def _expect(self, running: Running, plan: ScanPlan, *, by_hand: bool = False) -> None:
        for note in plan.notes:
            self._desk.notify(note)
        # How long a person takes for a pose nobody knows before the first.
        left = None if by_hand else plan.seconds
        self._slate.write(
            capture=running.order.name, done=0, planned=plan.records, left_s=left, needed_bytes=plan.bytes
        )

    def _live(self, running: Running, plan: ScanPlan, folder: Path) -> LiveCloud:
        """The cloud that grows; it takes what is on the disk where a capture is resumed."""
        calibration = self.calibration
        if calibration is None:
            raise OptionError("there is no calibration yet.")
        camera = running.rig.camera
        self._slate.clear_cloud(plan.records * max(camera.width, camera.height))
        scanner, header = jaxscan.load_scanner(calibration), sweep_header(running.rig)
        live = LiveCloud(folder, header, scanner, steps=plan.records, show=self._slate.grow)
        if running.order.resume and (folder / HEADER_NAME).exists():
            # A capture without records cannot be opened, and has none to add.
            with suppress(CaptureError):
                live.add_from_disk()
        return live


def _refused(result: dict[str, Any]) -> dict[str, Any]:
    """What a verb said of a calibration that may not be used."""
    told = {name: result.get(name) for name in ("verdict", "advice", "warnings")}
    # A recalibration that gained nothing tells lengths in another form.
    return told | {"lengths": [one for one in result.get("lengths") or [] if "what" in one]}
