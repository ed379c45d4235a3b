"""The three sessions that a page may ask for: to look, to sweep, and to capture the board."""

import math
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxscan
from jaxscan.cli.boards import CommandOperator, make_guide
from jaxscan.cli.console.boards import PageOperator, on_board_pair
from jaxscan.cli.console.desk import Desk, Running, progress_of
from jaxscan.cli.console.painter import Seen
from jaxscan.cli.console.works import Work, Works
from jaxscan.cli.live import LiveCloud
from jaxscan.cli.scan import ScanPlan, sweep_header
from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import HEADER_NAME


if TYPE_CHECKING:
    from scanrig.session import PlacementRequest, Sight

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
        from scanrig.doctor import judge_exposure
        from scanrig.session import Hooks, run_aiming

        def see(sight: "Sight") -> None:
            facts: dict[str, Any] = {"proof": "" if sight.proof.ok else sight.proof.reason}
            if sight.proof.ok:
                found = judge_exposure(sight.pair, running.rig)
                facts["exposure"] = {"verdict": found.verdict, "found": found.found, "do": found.do}
            running.painter.show(Seen(sight.on, sight.off, sight.pair.laser, facts))

        hooks = Hooks(notify=self._desk.notify, should_stop=running.should_stop)
        return run_aiming(running.rig, running.devices, see, hooks)

    def sweep(self, running: Running) -> str:
        """Take a sweep; with a calibration the cloud grows meanwhile, and is written at the end."""
        from scanrig.session import Hooks, run_sweep

        from jaxscan.files.calibration import calibration_digest

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
            progress = progress_of(self._slate, time.monotonic, None if by_hand else plan.seconds)
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

        def then(well: bool, result: dict[str, Any]) -> None:
            if result:
                self._slate.write(verdict={"capture": name, "well": well} | _verdict(result))
            if well:
                self.calibration = file
                self._slate.write(calibration=str(file))
            self.list()

        words = ["calibrate", str(self._captures.path(name)), "-o", str(file)]
        self._works.begin(Work(f"calibrate {name}" + (f", {of}" if of else ""), words, then))

    def reconstruct(self, name: str) -> None:
        """Make the cloud of a sweep.

        Raises:
            OptionError: If there is no calibration.
        """
        if self.calibration is None:
            raise OptionError("there is no calibration yet: capture the board first, or begin with --calibration.")
        cloud = self._captures.cloud(name)
        words = ["reconstruct", str(self._captures.path(name)), "-c", str(self.calibration), "-o", str(cloud)]
        self._works.begin(Work(f"reconstruct {name}", words, lambda well, result: self.list()))

    def compare(self, name: str, other: str) -> None:
        """Compare two clouds."""
        words = ["measure", "compare", str(self._captures.cloud(name)), str(self._captures.cloud(other))]
        self._works.begin(Work(f"compare {name} with {other}", words))

    def list(self) -> None:
        """Show the captures in the folder, and the space that is left."""
        from scanrig.recording import free_bytes

        folder = self._captures.folder.absolute()
        there = next(path for path in (folder, *folder.parents) if path.exists())
        self._slate.write(captures=self._captures.listed(), free_bytes=free_bytes(there))

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


def _verdict(result: dict[str, Any]) -> dict[str, Any]:
    return {name: result.get(name) for name in ("verdict", "lengths", "advice", "warnings", "missing")}
