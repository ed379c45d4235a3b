"""GenICam cameras over real GigE Vision on loopback, against Debian's simulated camera (rows 16, 17 and 18)."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from scanrig.cameras import CameraSettings, list_cameras, open_camera
from scanrig.errors import CameraError, CameraLost, CameraTimeout


SERVER = shutil.which("arv-fake-gv-camera-0.8")
REQUIRED = bool(os.environ.get("JAXSCAN_REQUIRE_BENCH"))
pytestmark = pytest.mark.skipif(
    SERVER is None and not REQUIRED, reason="needs arv-fake-gv-camera-0.8: type `make bench-deps`"
)


class Server:
    """Debian's simulated camera, which can be killed and started again."""

    def __init__(self, address):
        self.address, self.process = address, None

    def start(self, *options):
        self.process = subprocess.Popen([SERVER, "-i", self.address, *options], stdout=subprocess.DEVNULL)
        return self

    def kill(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


@pytest.fixture
def server(loopback):
    one = Server(loopback)
    yield one
    one.kill()


def settings(**options):
    given = {"id": "127.0.0.1", "width": 320, "height": 240, "trigger": "software", "exposure_ms": 5.0, "gain_db": 1.0}
    return CameraSettings(kind="aravis", **{**given, **options})


def opened(**options):
    """Open as soon as the camera answers."""
    end = time.monotonic() + 20.0
    while True:
        try:
            return open_camera(settings(**options))
        except CameraLost:
            if time.monotonic() > end:
                raise


def exposed(camera, timeout_s=5.0):
    camera.trigger()
    return camera.next(timeout_s)


def test_one_frame_per_trigger_and_what_it_is_set_to(server):
    server.start()
    with opened() as camera:
        assert camera.identity.kind == "aravis" and camera.identity.serial == "GV01"
        features = camera.features()
        assert features["exposure_s"] == pytest.approx(0.005) and features["gain_db"] == 1.0
        assert (features["width"], features["height"], features["pixel_format"]) == (320, 240, "mono8")
        assert features["trigger"] == "software" and features["GainAuto"] == "Off" and features["packet_size"] >= 576
        camera.start()
        camera.start()
        frames = [exposed(camera) for _ in range(4)]
        assert all(frame.complete and frame.image.shape == (240, 320) for frame in frames)
        assert np.diff([frame.number for frame in frames]).tolist() == [1, 1, 1]
        assert len({frame.image.tobytes() for frame in frames}) == 4
        start = time.monotonic()
        with pytest.raises(CameraTimeout, match="one per trigger"):
            camera.next(0.3)
        assert 0.25 < time.monotonic() - start < 3.0
        # Frames that wait are thrown away, and are not missing after that.
        camera.trigger()
        time.sleep(0.5)
        assert camera.drop() == 1
        assert exposed(camera).number == frames[-1].number + 2
        # A second program may look, not touch.
        with pytest.raises(CameraError, match="another program"):
            open_camera(settings())
    camera.close()
    with pytest.raises(CameraLost, match="closed"):
        camera.next(0.1)


ABANDONED = """
import os, signal, sys
from scanrig.cameras import CameraSettings, open_camera
camera = open_camera(CameraSettings.model_validate_json(sys.argv[1]))
camera.start()
camera.trigger()
camera.next(5.0)
os.kill(os.getpid(), signal.SIGKILL)
"""


HEARTBEAT = 0x938
"""The register of the heartbeat's timeout in milliseconds."""


@pytest.fixture
def device(loopback):
    """The bench's camera within this process, whose registers a test may set."""
    from bench.camera.network import GvCamera

    one = GvCamera(lambda: np.zeros((512, 640), np.uint8), address=loopback)
    yield one
    one.close()


@pytest.mark.parametrize("heartbeat_ms", [3000, 6000])
def test_a_camera_that_a_killed_program_left_running_is_taken_over(device, heartbeat_ms):
    """Its heartbeat is awaited, with a sentence where that is long; no frame goes to the program that is gone."""
    done = subprocess.run([sys.executable, "-c", ABANDONED, settings().model_dump_json()], timeout=60)
    assert done.returncode == -signal.SIGKILL
    device.write(HEARTBEAT, heartbeat_ms)
    said, start = [], time.monotonic()
    with open_camera(settings(), said.append) as camera:
        assert time.monotonic() - start < 12.0
        camera.start()
        assert all(exposed(camera).complete for _ in range(3))
    if heartbeat_ms > 3000:
        (sentence,) = said
        assert sentence.startswith('camera "127.0.0.1": another program controls it; if that one has ended')
        assert sentence.endswith("free in at most 8 s.")


def test_a_long_heartbeat_is_shortened(device):
    device.write(HEARTBEAT, 30_000)
    with opened() as camera:
        assert device.register(HEARTBEAT) == 3000
        device.write(HEARTBEAT, 1000)
        camera.reopen()
        assert device.register(HEARTBEAT) == 1000


FLOOD = """
import socket
one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    one.sendto(b"x" * 500, ("127.0.0.1", 9))
"""


def test_packets_of_others_are_not_taken_for_frames(server):
    """To a root user libaravis would show, until its filter is set, every packet that crosses the interface."""
    server.start()
    opened().close()
    with subprocess.Popen([sys.executable, "-c", FLOOD]) as flood:
        try:
            for _ in range(8):
                with opened() as camera:
                    camera.start()
                    frames = [exposed(camera) for _ in range(2)]
                    assert all(frame.complete for frame in frames)
                    assert camera.drop() == 0 and frames[1].number == frames[0].number + 1
        finally:
            flood.kill()


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"width": 4096}, r"4096 x 240 px.*maximum"),
        ({"gain_db": 40.0}, "gain_db = 40.*maximum"),
        ({"trigger": "hardware", "trigger_source": "Line7"}, 'TriggerSource: does not take "Line7"'),
    ],
)
def test_what_it_does_not_take_is_named(server, wrong, message):
    server.start()
    opened().close()
    with pytest.raises(CameraError, match=message):
        opened(**wrong)


def test_a_setting_that_it_only_seems_to_take(server, monkeypatch):
    """Row 18: the features that the camera then reports are compared, at opening and at reopening."""
    server.start()
    camera = opened()
    real = camera.read
    monkeypatch.setattr(camera, "read", lambda one: {**real(one), "exposure_s": 0.04, "pixel_format": "Mono16"})
    with pytest.raises(CameraError, match=r"exposure_s: found 0.04, expected 0.005") as problem:
        camera.reopen()
    assert 'pixel_format: found "Mono16", expected "mono8"' in str(problem.value)
    monkeypatch.undo()
    camera.reopen()
    assert camera.features()["exposure_s"] == pytest.approx(0.005)
    camera.close()


def test_hardware_trigger_waits_for_the_wire(server):
    server.start()
    with opened(trigger="hardware", trigger_source="Line0") as camera:
        assert camera.features()["trigger"] == "hardware" and camera.features()["trigger_source"] == "Line0"
        camera.start()
        with pytest.raises(CameraTimeout, match="wire"):
            camera.next(0.3)
        with pytest.raises(CameraError, match="software"):
            camera.trigger()


@pytest.mark.parametrize(
    "pixel_format, shape", [("rgb8", (240, 320, 3)), ("bayer_grbg8", (240, 320)), ("mono16", (240, 320))]
)
def test_pixel_formats_and_free_running(server, pixel_format, shape):
    server.start()
    with opened(pixel_format=pixel_format, trigger="free", packet_size=4000) as camera:
        assert camera.features()["packet_size"] == 4000 and camera.features()["trigger"] == "free"
        camera.start()
        first = camera.next(5.0)
        assert first.image.shape == shape and first.complete
        assert first.image.dtype == (np.uint16 if pixel_format == "mono16" else np.uint8)
        time.sleep(0.3)
        assert camera.drop() >= 2
        assert camera.next(5.0).number > first.number + 2


def test_lost_packets_make_incomplete_frames(server):
    """Row 17: a frame with a hole says so, and the hole is black."""
    server.start("-r", "20")
    with opened(width=1024, height=512) as camera:
        camera.start()
        frames = [exposed(camera) for _ in range(12)]
        torn = [frame for frame in frames if not frame.complete]
        # 375 packets per frame, 2 % of them lost: a whole frame is one in 2000.
        assert len(torn) >= 10
        assert all(frame.note and frame.image.shape == (512, 1024) for frame in torn)


def test_two_triggers_at_once_are_one_frame(server):
    """Row 17: this camera looks every 40 ms; the frame that is not made is a timeout, not a wrong one."""
    server.start()
    with opened() as camera:
        camera.start()
        first = exposed(camera)
        camera.trigger()
        camera.trigger()
        assert camera.next(5.0).number == first.number + 1
        with pytest.raises(CameraTimeout):
            camera.next(0.3)


@pytest.mark.slow
def test_a_camera_that_dies_is_lost_and_comes_back(server):
    """Row 16: noticed within seconds, reopened with all its settings."""
    server.start()
    camera = opened()
    camera.start()
    exposed(camera)
    server.kill()
    start = time.monotonic()
    with pytest.raises(CameraLost, match="gone"):
        camera.next(1.0)
    assert time.monotonic() - start < 12.0
    with pytest.raises(CameraLost, match="not found"):
        camera.reopen()
    server.start()
    end = time.monotonic() + 30.0
    while True:
        try:
            camera.reopen()
            break
        except CameraLost:
            assert time.monotonic() < end
    assert camera.features()["exposure_s"] == pytest.approx(0.005)
    assert exposed(camera).complete
    camera.close()


def test_another_camera_in_its_place_is_refused(server):
    server.start()
    camera = opened()
    server.kill()
    server.start("-s", "OTHER")
    time.sleep(0.5)
    with pytest.raises(CameraError, match="Fake OTHER, expected aravis Aravis Fake GV01"):
        for _ in range(5):
            try:
                camera.reopen()
            except CameraLost:
                time.sleep(0.2)
    camera.close()


@pytest.mark.slow
def test_cameras_are_found_by_search(server):
    server.start()
    opened().close()
    assert any("GV01" in line and "127.0.0.1" in line for line in list_cameras())
    for name in ("GV01", ""):
        with open_camera(settings(id=name)) as camera:
            assert camera.identity.serial == "GV01"
    with pytest.raises(CameraLost, match=r'"NONE": not found; found: "Aravis-Fake-GV01"'):
        open_camera(settings(id="NONE"))


def test_the_bench_camera_is_found_here_and_hears_nobody_else(device):
    assert device.register(HEARTBEAT) == 3000
    bound = []
    for name in os.listdir("/proc/self/fd"):
        if os.path.realpath(f"/proc/self/fd/{name}").rpartition("/")[2].startswith("socket:"):
            with socket.socket(fileno=os.dup(int(name))) as one:
                if one.family == socket.AF_INET and one.getsockname()[1] == 3956:
                    bound.append((one.getsockname()[0], one.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)))
    assert sorted(bound) == [("127.0.0.1", b""), ("255.255.255.255", b"lo\0")]
