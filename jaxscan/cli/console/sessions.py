"""The three sessions that a page may ask for: to look, to sweep, and to capture the board."""

import math
import queue
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxscan
from jaxscan.cli.boards import CommandOperator, make_guide
from jaxscan.cli.console.captures import Captures
from jaxscan.cli.console.desk import Desk, Running
from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.watching import Painter, Seen
from jaxscan.cli.console.works import Works
from jaxscan.cli.live import LiveCloud
from jaxscan.cli.progress import Remaining
from jaxscan.cli.scan_display import ScanPlan, sweep_header
from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import HEADER_NAME


if TYPE_CHECKING:
    from scanrig.checks.guide import Coverage, Guide, Look
    from scanrig.doctor import Finding
    from scanrig.session import PlacementRequest, Sight

_GOOD_ENOUGH, _AUTO_STEP, _SHORTEST_MS, _LONGEST_MS = 0.12, 4.0, 0.05, 2000.0
"""How near to the best exposure "auto" ends, its largest step, and its limits."""
_ENOUGH_PLACEMENTS = 2
"""Number of standing places after which a first calibration is tried during the capture."""


class Sessions:
    """The sessions of a desk, and the works that follow them."""

    def __init__(self, desk: Desk, works: Works, captures: Captures, place_command: str | None = None) -> None:
        """Give the desk its sessions; a command may place the board."""
        self._desk, self._works, self._slate, self._captures = desk, works, desk.slate, captures
        self._place_command = place_command
        desk.after = works.refresh
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
            if self._desk.auto > 0:
                self._expose_better(found, ms, gain)

        hooks = Hooks(notify=self._desk.notify, should_stop=running.should_stop)
        return run_aiming(running.rig, running.devices, see, hooks, self._desk.wish)

    def _expose_better(self, found: "Finding", exposure_ms: float, gain_db: float) -> None:
        """One step of "auto": the exposure with which the line would be as bright as it should be."""
        desk, factor = self._desk, found.values["factor"]
        clear = found.values["clipped"] == 0 and found.values["peak_dn"] > 0
        good = clear and abs(factor - 1) < _GOOD_ENOUGH
        desk.auto = 0 if good else desk.auto - 1
        if good:
            self._slate.say(f"Auto: the exposure is {exposure_ms:.3g} ms; {found.found}.")
        elif not desk.auto:
            self._slate.say(f"Auto: found no better exposure than {exposure_ms:.3g} ms; {found.found}.", "problem")
        else:
            better = exposure_ms * float(np.clip(factor, 1 / _AUTO_STEP, _AUTO_STEP))
            desk.expose(float(f"{np.clip(better, _SHORTEST_MS, _LONGEST_MS):.3g}"), gain_db)
            return
        desk.show_wish()

    def sweep(self, running: Running) -> str:
        """Take a sweep; with a calibration the cloud grows meanwhile, and is written at the end."""
        from scanrig.session import Hooks, run_sweep

        rig, order, calibration = running.rig, running.order, self._works.calibration
        plan = ScanPlan.of(rig, boards=False)
        progress = self._progress(running, plan, plan.seconds)
        with ExitStack() as stack:
            live = None if calibration is None else stack.enter_context(self._live(running, plan, calibration))

            def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
                facts = {"record": number, "angle_deg": round(math.degrees(angle), 3)}
                running.painter.show(Seen(on, off, rig.laser_of(number), facts))
                if live is not None:
                    live.add(number, angle, on, off)
                    self._slate.write(cloud=live.status()._asdict())

            result = run_sweep(
                rig,
                self._captures.path(order.name),
                running.devices,
                Hooks(on_pair, progress, self._desk.notify, running.should_stop),
                resume=order.resume,
                calibration_digest=None if calibration is None else calibration_digest(calibration),
            )
        if result.status == "complete" and self._works.calibration is not None:
            self._works.carry_out(Order("reconstruct", order.name))
        return str(result.message)

    def _live(self, running: Running, plan: ScanPlan, calibration: Path) -> LiveCloud:
        """The cloud that grows; it takes what is on the disk where a capture is resumed."""
        folder, camera = self._captures.path(running.order.name), running.rig.camera
        self._slate.clear_cloud(plan.records * max(camera.width, camera.height))
        scanner, header = jaxscan.load_scanner(calibration), sweep_header(running.rig)
        live = LiveCloud(folder, header, scanner, steps=plan.records, show=self._slate.grow)
        if running.order.resume and (folder / HEADER_NAME).exists():
            # A capture without records cannot be opened, and has none to add.
            with suppress(CaptureError):
                live.add_from_disk()
        return live

    def boards(self, running: Running) -> str:
        """Capture the board; a calibration is tried as soon as one is possible."""
        from scanrig.session import Hooks, run_calibration

        rig, order, desk = running.rig, running.order, self._desk
        if rig.board is None:
            raise OptionError(f"{desk.config}: has no [board] table, which captures of boards need.")
        command = None
        if self._place_command is not None:
            free = rig.calibration.free_views
            command = CommandOperator(self._place_command, free_views=free, console=desk.out)
        progress = self._progress(running, ScanPlan.of(rig, boards=True))
        guide = make_guide(rig)

        def try_calibration(request: "PlacementRequest") -> None:
            if request.kind == "placement" and request.number >= _ENOUGH_PLACEMENTS and not self._works.busy:
                self._works.carry_out(Order("calibrate", order.name), of="the poses so far")

        operator = PageOperator(guide, running.painter, self._slate, running.should_stop, try_calibration, command)

        def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
            request, laser = operator.placing, rig.laser_of(number)
            turning = request is not None and request.kind == "placement"
            seen = guide.look(on, off, laser)
            guide.keep(seen, request.number if turning and request is not None else None)
            running.painter.show(Seen(on, off, laser, {"record": number}))
            self._slate.write(guide=guidance(guide, seen, "placement" if turning else "free"))

        desk.answer = operator.answer
        try:
            hooks = Hooks(on_pair, progress, desk.notify, running.should_stop)
            folder = self._captures.path(order.name)
            result = run_calibration(rig, folder, running.devices, operator, hooks, resume=order.resume)
        finally:
            desk.answer = None
            self._slate.write(placing=None)
        if command is not None:
            command.take_away()
        if result.status == "complete":
            self._works.carry_out(Order("calibrate", order.name))
        return str(result.message)

    def _progress(self, running: Running, plan: ScanPlan, seconds: float | None = None) -> Callable[[int, int], None]:
        """Show what is planned; returns the hook that shows how far it is, and how long it still takes.

        `seconds` is unknown for boards: how long a person or a command takes for a pose shows with the first.
        """
        for note in plan.notes:
            self._desk.notify(note)
        remaining = Remaining(time.monotonic, from_first=True)
        work: Sequence[int] = plan.work
        self._slate.write(
            capture=running.order.name, done=0, planned=plan.records, left_s=seconds, needed_bytes=plan.bytes
        )

        def progress(done: int, planned: int) -> None:
            left = remaining(work[done], work[planned]) if len(work) > planned else remaining(done, planned)
            if left is None and seconds is not None:
                left = seconds / max(planned, 1) * (planned - done)
            self._slate.write(done=done, planned=planned, left_s=None if left is None else round(left, 1))

        return progress


_BETWEEN_S = 0.1


class PageOperator:
    """An `Operator` of `scanrig.session`: a person at the page, or a command in place of one."""

    def __init__(
        self,
        guide: "Guide",
        painter: Painter,
        slate: Slate,
        should_stop: Callable[[], bool],
        before: Callable[["PlacementRequest"], None],
        command: CommandOperator | None,
    ) -> None:
        """Ask on the slate; `before` is called before the board is placed."""
        self._guide, self._painter, self._slate = guide, painter, slate
        self._should_stop, self._before, self._command = should_stop, before, command
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._enough = False
        self.placing: PlacementRequest | None = None
        """The request for which the board is placed now."""

    def answer(self, word: str) -> None:
        """An answer of the person, from another thread: "take", "enough" (of this kind), or "enough of all"."""
        self._answers.put(word)

    def place(self, request: "PlacementRequest") -> bool:
        """Look, and show what is seen, until the person takes it or says that it is enough."""
        if self._enough:
            return False
        self.placing = request
        self._before(request)
        asked = {"kind": request.kind, "number": request.number, "total": request.total, "at_deg": request.at_deg}
        if self._command is not None:
            self._slate.write(doing="boards", placing=asked)
            return self._command.place(request)
        while not self._answers.empty():
            # Pressed too early, it would take the board while it is moved to the next pose.
            self._answers.get()
        # The session has cut the laser's power, because somebody is in front of it.
        self._slate.write(doing="placing", placing=asked, laser="off")
        while not self._should_stop():
            self._look(request)
            try:
                word = self._answers.get(timeout=_BETWEEN_S)
            except queue.Empty:
                continue
            if word != "take":
                self._enough = word == "enough of all"
                return False
            if self._look(request):
                self._slate.write(doing="boards", laser="may shine")
                return True
        return False

    def _look(self, request: "PlacementRequest") -> bool:
        """Show what is seen now, and whether the board is."""
        frame = request.look()
        look = self._guide.look(None, frame)
        self._painter.show(Seen(None, frame, 0, {}))
        self._slate.write(guide=guidance(self._guide, look, request.kind))
        return look.view is not None


_TILT_DEG = 30.0
_SIDES_DEG = (0.0, 90.0, 180.0, 270.0)


def guidance(guide: "Guide", look: "Look", kind: str) -> dict[str, Any]:
    """What a page needs to draw the board as it is held, what is covered, and where to hold it next.

    Args:
        guide: With the poses so far.
        look: The present pose.
        kind: "free" or "placement".
    """
    from jaxscan.geometry.coverage import MIN_IN_CELL, MIN_TILT_DEG

    seen = guide.coverage()
    pose = None if look.view is None else guide.pose(look)
    return {
        "advice": guide.advice("placement" if kind == "placement" else "free"),
        "covered": (seen.corners >= MIN_IN_CELL).tolist(),
        "corners": seen.corners.tolist(),
        "views": seen.views,
        "min_tilt_deg": MIN_TILT_DEG,
        "depth_m": seen.depth_m,
        "next": _next(seen),
        "found": [] if look.view is None else look.view.q.round(1).tolist(),
        "problem": look.problem,
        "pose": None if pose is None else {name: round(value, 3) for name, value in vars(pose).items()},
    }


def _next(seen: "Coverage") -> dict[str, Any]:
    """A place in the image, 0 ... 1 in both directions, and a tilt: the emptiest cell, and a side not shown yet."""
    rows, columns = seen.corners.shape
    row, column = np.unravel_index(int(np.argmin(seen.corners)), seen.corners.shape)
    everywhere = not seen.views or bool(seen.corners.min() > 0)
    at = [0.5, 0.5] if everywhere else [(column + 0.5) / columns, (row + 0.5) / rows]
    side = _SIDES_DEG[seen.views % len(_SIDES_DEG)]
    return {"at": at, "tilt_deg": _TILT_DEG if seen.views else 0.0, "towards_deg": side}
