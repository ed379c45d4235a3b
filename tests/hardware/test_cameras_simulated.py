"""The interface of all cameras on the one in software, with every fault that it can have; and folders of images."""

import threading
import time

import numpy as np
import pydantic
import pytest
from scanrig.cameras import CameraSettings
from scanrig.cameras.aravis import FrameNumbers, text
from scanrig.cameras.camera import differences
from scanrig.cameras.simulated import SimulatedCamera
from scanrig.errors import CameraError, CameraLost, CameraTimeout

from .faulty_camera import FaultyCamera


SETTINGS = CameraSettings(kind="simulated", width=96, height=64)


def numbered(position, lit):
    """A frame that says where it was taken, and whether the laser was on."""
    return np.full((64, 96), round(position) * 2 + lit, np.uint8)


def shown(frame):
    return int(frame.image[0, 0]) // 2, bool(frame.image[0, 0] % 2)


def camera(faults=None):
    made = FaultyCamera(SETTINGS, numbered)
    made.faults = faults or {}
    made.start()
    return made


def shots(made, positions):
    for position in positions:
        made.expose(position, True)
        made.expose(position, False)


def waiting(made):
    found = []
    while True:
        try:
            found.append(made.next(1.0))
        except CameraTimeout:
            return found


# Frames and faults.


def test_frames_come_in_order():
    made = camera()
    shots(made, [3, 4])
    frames = waiting(made)
    assert [shown(frame) for frame in frames] == [(3, True), (3, False), (4, True), (4, False)]
    assert [frame.number for frame in frames] == [1, 2, 3, 4]
    assert all(frame.complete for frame in frames)


@pytest.mark.parametrize(
    "fault, numbers, seen",
    [
        ("missing", [1, 2, 4], [(1, True), (1, False), (2, False)]),
        ("duplicate", [1, 2, 3, 3, 4], [(1, True), (1, False), (2, True), (2, True), (2, False)]),
        ("stale", [1, 2, 3, 4], [(1, True), (1, False), (1, False), (2, False)]),
        ("swapped", [1, 2, 3, 4], [(1, True), (1, False), (2, False), (2, True)]),
        ("late", [1, 2, 3, 4], [(1, True), (1, False), (2, True), (2, False)]),
    ],
)
def test_faults_are_what_they_say(fault, numbers, seen):
    made = camera(faults={3: fault})
    shots(made, [1, 2])
    frames = waiting(made)
    assert [frame.number for frame in frames] == numbers
    assert [shown(frame) for frame in frames] == seen


def test_an_incomplete_frame_says_so():
    made = camera(faults={1: "incomplete"})
    shots(made, [9])
    torn, whole = waiting(made)
    assert not torn.complete and "missing" in torn.note and whole.complete
    assert torn.image[0].all() and not torn.image[-1].any()


def test_a_lost_camera_comes_back():
    made = camera(faults={2: "lost"})
    made.expose(1, True)
    assert shown(made.next(1.0)) == (1, True)
    made.expose(1, False)
    with pytest.raises(CameraLost):
        made.next(1.0)
    made.reachable = False
    with pytest.raises(CameraLost, match="not found"):
        made.reopen()
    made.reachable = True
    made.reopen()
    made.expose(2, True)
    assert shown(made.next(1.0)) == (2, True)


def test_a_camera_that_comes_back_otherwise_is_refused():
    made = camera()
    made.after_reopen = {"exposure_s": 0.033, "pixel_format": "rgb8"}
    with pytest.raises(CameraError, match=r"exposure_s: found 0.033, expected 0.01") as problem:
        made.reopen()
    assert 'pixel_format: found "rgb8", expected "mono8"' in str(problem.value)


def test_no_frame_is_a_timeout():
    made = SimulatedCamera(SETTINGS, numbered)
    made.start()
    start = time.monotonic()
    with pytest.raises(CameraTimeout, match=r"within 0.05 s"):
        made.next(0.05)
    assert 0.04 < time.monotonic() - start < 2.0


def test_waiting_ends_when_a_frame_comes():
    made = SimulatedCamera(SETTINGS, numbered)
    made.start()
    timer = threading.Timer(0.05, made.expose, (7, True))
    timer.start()
    assert shown(made.next(30.0)) == (7, True)
    timer.join()


def test_drop_throws_away_what_waits():
    made = camera()
    shots(made, [1, 2])
    assert made.drop() == 4
    made.expose(3, True)
    assert [shown(frame) for frame in waiting(made)] == [(3, True)]


def test_only_software_triggers_trigger():
    made = camera()
    with pytest.raises(CameraError, match="software"):
        made.trigger()
    settings = SETTINGS.model_copy(update={"trigger": "software"})
    made = FaultyCamera(settings, numbered, world=lambda: (6.0, True))
    made.start()
    made.trigger()
    assert shown(made.next(1.0)) == (6, True)


def test_a_closed_camera_is_lost():
    with camera() as made:
        pass
    with pytest.raises(CameraLost):
        made.next(1.0)
    made.close()


# Settings, features and numbers.


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"kind": "opencv", "trigger": "hardware"}, "can only be"),
        ({"kind": "opencv", "trigger": "free", "pixel_format": "bayer_rggb8"}, "mono8"),
        ({"kind": "simulated", "exposure_ms": 0.0}, "greater than 0"),
        ({"kind": "simulated", "exposure": 5.0}, "Extra inputs"),
        ({"kind": "simulated", "width": 60000, "height": 60000}, "megapixels"),
    ],
)
def test_settings_that_mean_nothing(wrong, message):
    with pytest.raises(pydantic.ValidationError, match=message):
        CameraSettings(**{"width": 64, "height": 64, **wrong})


def test_features_are_compared_as_finely_as_cameras_can_be_set():
    expected = {"width": 640, "exposure_s": 0.01, "gain_db": 6.0, "trigger": "hardware"}
    assert differences({**expected, "exposure_s": 0.01003, "gain_db": 6.1}, expected) == []
    assert len(differences({"width": 641, "exposure_s": 0.011, "gain_db": 7.0, "trigger": "free"}, expected)) == 4
    assert differences({"width": 640}, expected) == []


@pytest.mark.parametrize(
    "raws, numbers, advances",
    [
        ([10, 11, 12], [10, 11, 12], [1, 1, 1]),
        ([65534, 65535, 1, 2], [65534, 65535, 65536, 65537], [1, 1, 1, 1]),
        ([65535, 0, 1], [65535, 65536, 65537], [1, 1, 1]),
        ([65533, 2], [65533, 65537], [1, 4]),
        ([1, 5], [1, 5], [1, 4]),
        ([5, 5, 6], [5, 5, 6], [1, 0, 1]),
        ([5, 7, 6, 8], [5, 7, 6, 8], [1, 2, -1, 1]),
        ([1 << 40, (1 << 40) + 2], [1 << 40, (1 << 40) + 2], [1, 2]),
    ],
)
def test_frame_ids_wrap(raws, numbers, advances):
    count = FrameNumbers()
    assert [count.take(raw) for raw in raws] == list(zip(numbers, advances, strict=True))


# Folders.


def test_a_cameras_own_words_cannot_steer_a_terminal():
    assert text("Kamera №1".encode()) == "Kamera №1" and text(None) == ""
    assert text(b"\x1b[2JModel\r\n\xff") == "?[2JModel??\ufffd"
