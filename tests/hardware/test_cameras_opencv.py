"""A free-running camera: a stream on loopback whose pictures count, read so that nothing old is taken for new."""

import http.server
import os
import threading
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from scanrig.cameras import CameraSettings, open_camera
from scanrig.cameras.opencv import apply_settings, read_features
from scanrig.errors import CameraError, CameraLost, CameraTimeout


RATE = 25.0
WIDTH, HEIGHT, CELL, BITS = 256, 128, 16, 12


def picture(number):
    """A frame whose first row of cells is its number; blue on the left, red on the right below (BGR here)."""
    image = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    for bit in range(BITS):
        image[:CELL, bit * CELL : (bit + 1) * CELL] = 255 * (number >> bit & 1)
    image[2 * CELL :, : WIDTH // 2] = (255, 0, 0)
    image[2 * CELL :, WIDTH // 2 :] = (0, 0, 255)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def number_in(image):
    grey = image if image.ndim == 2 else image.mean(2)
    cells = [grey[CELL // 4 : 3 * CELL // 4, b * CELL + 4 : (b + 1) * CELL - 4].mean() > 128 for b in range(BITS)]
    return sum(int(on) << bit for bit, on in enumerate(cells))


class Stream:
    """Frames that are counted from when the camera was switched on; tests set `stalled` and `over`."""

    def __init__(self):
        self.start, self.stalled, self.over = time.monotonic(), threading.Event(), threading.Event()
        stream = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=b")
                self.end_headers()
                try:
                    stream.send(self.wfile)
                except OSError:
                    self.close_connection = True  # The reader hung up.

            def log_message(self, *arguments):
                del arguments

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/stream.mjpg"

    def now(self):
        return int((time.monotonic() - self.start) * RATE)

    def send(self, file):
        """The sender queues nothing itself: old frames are in the sockets and in the reader."""
        due = self.now()
        while not self.over.is_set():
            while time.monotonic() < self.start + due / RATE and not self.over.is_set():
                time.sleep(0.002)
            if not self.stalled.is_set():
                data = picture(due)
                file.write(
                    b"--b\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data) + data + b"\r\n"
                )
                file.flush()
            due += 1


@contextmanager
def streaming():
    stream = Stream()
    thread = threading.Thread(target=stream.server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield stream
    finally:
        stream.over.set()
        stream.server.shutdown()
        stream.server.server_close()
        thread.join()


@pytest.fixture
def stream():
    with streaming() as one:
        yield one


def settings(url, **options):
    given = {"width": WIDTH, "height": HEIGHT, "pixel_format": "rgb8", "trigger": "free", "exposure_ms": 10.0}
    return CameraSettings(kind="opencv", id=url, **{**given, **options})


@pytest.fixture
def camera(stream):
    with open_camera(settings(stream.url)) as made:
        made.start()
        yield made


def test_after_a_pause_the_next_frame_is_new(stream, camera):
    camera.next(10.0)
    for _ in range(2):
        # Ten frames wait by then.
        time.sleep(0.4)
        asked = stream.now()
        camera.drop()
        frame = camera.next(10.0)
        # The number of the frame is when it was exposed, by the clock of the one who sent it.
        assert number_in(frame.image) > asked
        assert number_in(frame.image) <= stream.now()


def test_at_least_so_many_frames_are_discarded_and_mono_ones_have_one_channel(stream):
    with open_camera(settings(stream.url, pixel_format="mono8", flush_frames=5)) as made:
        made.start()
        assert made.next(10.0).image.shape == (HEIGHT, WIDTH)
        asked = stream.now()
        made.drop()
        assert number_in(made.next(10.0).image) > asked + 4


def test_frames_follow_one_another(camera):
    numbers = [number_in(camera.next(10.0).image) for _ in range(6)]
    assert numbers == sorted(set(numbers))


def test_colours_are_red_green_blue(camera):
    frame = camera.next(10.0)
    assert frame.image.shape == (HEIGHT, WIDTH, 3) and frame.image.dtype == np.uint8
    left, right = frame.image[100, 20].astype(int), frame.image[100, WIDTH - 20].astype(int)
    assert left[2] > 200 > 60 > left[0] and right[0] > 200 > 60 > right[2]
    assert frame.number == -1 and frame.complete


def test_what_the_backend_cannot_say_is_noted(camera):
    assert "exposure_s" not in camera.features() and camera.features()["backend"] == "FFMPEG"
    assert "not known" in camera.next(10.0).note
    with pytest.raises(CameraError, match="no triggers"):
        camera.trigger()


def test_a_stall_is_a_timeout_and_passes(stream, camera):
    camera.next(10.0)
    stream.stalled.set()
    time.sleep(0.3)
    camera.drop()
    start = time.monotonic()
    with pytest.raises(CameraTimeout):
        camera.next(0.5)
    assert 0.4 < time.monotonic() - start < 3.0
    stream.stalled.clear()
    assert number_in(camera.next(10.0).image) > 0


def test_the_end_is_a_loss_and_reopening_brings_it_back():
    with streaming() as first:
        made = open_camera(settings(first.url))
        made.start()
        made.next(10.0)
        first.over.set()
        with pytest.raises(CameraLost, match="gone"):
            for _ in range(20):
                made.next(10.0)
    with pytest.raises(CameraLost, match="cannot be opened"):
        made.reopen()
    with pytest.raises(CameraLost):
        made.next(0.1)
    made.close()


def test_frames_of_another_size_are_refused(stream):
    with pytest.raises(CameraError, match="width: found 256, expected 320"):
        open_camera(settings(stream.url, width=320))


def test_frames_that_cannot_be_read_are_a_loss_and_not_a_silence(camera, monkeypatch):
    def fails(*arguments):
        raise cv2.error("Invalid number of channels\n in input image")

    monkeypatch.setattr("scanrig.cameras.opencv._image", fails)
    with pytest.raises(CameraLost, match="its frames cannot be read: Invalid number of channels in input image"):
        for _ in range(100):
            camera.next(1.0)
    monkeypatch.undo()
    camera.reopen()
    assert camera.next(5.0).complete


def test_no_device_no_stream():
    with pytest.raises(CameraLost, match="cannot be opened"):
        open_camera(settings("http://127.0.0.1:9/none.mjpg"))
    with pytest.raises(CameraLost, match="cannot be opened"):
        open_camera(settings("63"))


def test_what_can_never_be_a_camera_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for name in (tmp_path / "pipe", tmp_path / "link", tmp_path, "/dev/zero"):
        with pytest.raises(CameraError, match="neither a video device nor a file"):
            open_camera(settings(str(name)))
    for name in (
        "9" * 20,
        str(tmp_path / "none"),
        "pipe:0",
        f"file:{tmp_path}/pipe",
        f"file://{tmp_path}/pipe",
        "a\0b",
    ):
        with pytest.raises(CameraLost, match="cannot be opened"):
            open_camera(settings(name))


def test_a_device_whose_name_is_not_text_is_listed(tmp_path, monkeypatch):
    from scanrig.cameras import opencv

    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "name").write_bytes(b"Cam\xff\xfe\n")
    monkeypatch.setattr(opencv, "_DEVICES", tmp_path)
    assert opencv.found_by_opencv() == ['opencv "/dev/video0": Cam\ufffd\ufffd']


# A driver with properties, which no test machine has: a stand-in for `cv2.VideoCapture`.


class Driver:
    """Takes properties like V4L2 does, but for those in `refuses` and `changes`."""

    def __init__(self, refuses=(), changes=None):
        self.values = {cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_AUTOFOCUS: -1.0, cv2.CAP_PROP_AUTO_EXPOSURE: 3.0}
        self.refuses, self.changes = refuses, changes or {}

    def getBackendName(self):
        return "V4L2"

    def set(self, prop, value):
        if prop in self.refuses or self.values.get(prop) == -1.0:
            return False
        self.values[prop] = self.changes.get(prop, value)
        return True

    def get(self, prop):
        return float(self.values.get(prop, -1.0))


def differences_of(driver):
    from scanrig.cameras.camera import differences

    given = settings("0", gain_db=4.0)
    expected = apply_settings(driver, given, name="uvc")
    return differences(read_features(driver, given), expected)


def test_a_driver_is_set_and_read_back():
    driver = Driver()
    assert differences_of(driver) == []
    assert driver.values[cv2.CAP_PROP_EXPOSURE] == 100 and driver.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0
    assert driver.values[cv2.CAP_PROP_BUFFERSIZE] == 1 and driver.values[cv2.CAP_PROP_AUTO_WB] == 0


@pytest.mark.parametrize(
    "driver, name",
    [
        (Driver(changes={cv2.CAP_PROP_FRAME_WIDTH: 1280}), "width"),
        (Driver(changes={cv2.CAP_PROP_EXPOSURE: 156}), "exposure_s"),
        (Driver(changes={cv2.CAP_PROP_GAIN: 64}), "gain_db"),
        (Driver(changes={cv2.CAP_PROP_AUTO_EXPOSURE: 3}), "auto_exposure"),
        (Driver(refuses=(cv2.CAP_PROP_AUTO_WB,)), "auto_white_balance"),
    ],
)
def test_a_driver_that_does_otherwise_is_named(driver, name):
    (difference,) = differences_of(driver)
    assert difference.startswith(f"{name}: found")


def test_a_driver_that_cannot_expose_by_hand():
    with pytest.raises(CameraError, match="auto_exposure"):
        differences_of(Driver(refuses=(cv2.CAP_PROP_AUTO_EXPOSURE,)))
    with pytest.raises(CameraError, match="exposure_ms"):
        differences_of(Driver(refuses=(cv2.CAP_PROP_EXPOSURE,)))
