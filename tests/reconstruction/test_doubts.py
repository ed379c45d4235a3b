"""Doubts about a sweep: what contradicts itself is noted, and healthy sweeps of all kinds are not."""

import dataclasses
import re

import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import FrameWatch, journal_doubts
from jaxscan.reconstruction.doubts import (
    blank_frames,
    exchanged_frames,
    header_doubts,
    repeated_frames,
    strange_frames,
    turning_doubts,
)
from jaxscan.reconstruction.sweep import Sweep
from jaxscan.stripes import LaserLine


COUNT = 40
TURN = np.arange(COUNT) * 9.0
ONE = [(0,)] * COUNT


def microsteps(degrees, per_turn=28800):
    return np.round(np.asarray(degrees) * per_turn / 360) * 360 / per_turn


HEALTHY = {
    "a turn": (range(COUNT), TURN, ONE, None),
    "a planned turn": (range(COUNT), TURN, ONE, COUNT),
    "the other way": (range(COUNT), -TURN, ONE, None),
    "rounded to microsteps": (range(100), microsteps(np.arange(100) * 3.6 / 7), [(0,)] * 100, None),
    "every tenth": (range(0, 400, 10), TURN, ONE, None),
    "to and fro": (range(COUNT), np.concatenate([TURN[:20], TURN[20:0:-1]]), ONE, None),
    "two lasers in turn": (range(80), np.repeat(TURN, 2), [(0,), (1,)] * COUNT, 80),
    "two lasers, turn after turn": (range(80), np.tile(TURN, 2), [(0,)] * COUNT + [(1,)] * COUNT, None),
    "a closed turn": (range(41), np.linspace(0, 360, 41), [(0,)] * 41, None),
    "wrapped": (range(COUNT), (TURN + 100) % 360, ONE, None),
    "by hand": (range(COUNT), np.cumsum(np.random.default_rng(1).uniform(3, 12, COUNT)), ONE, None),
    "as reached": (range(COUNT), TURN + np.random.default_rng(2).normal(0, 0.2, COUNT), ONE, None),
    "finer from the middle": (range(COUNT), np.cumsum([4.0] * 20 + [2.0] * 20), ONE, None),
    "a small object": (range(COUNT), np.arange(COUNT) * 0.1, ONE, None),
    "few": (range(3), np.array([0.0, 0.0, 5.0]), ONE[:3], None),
}


@pytest.mark.parametrize("name", HEALTHY)
def test_a_healthy_journal_gives_no_doubt(name):
    assert journal_doubts(*HEALTHY[name]) == []


def edited(k, value):
    angles = TURN.copy()
    angles[k] = value
    return angles


def order(k, m):
    angles = TURN.copy()
    angles[[k, m]] = angles[[m, k]]
    return angles


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        (edited(7, 64.0), "record 7 does not continue"),
        (edited(7, 63.2), "record 7 does not continue"),
        (edited(7, 54.0), "does not continue"),
        (edited(0, 4.0), "does not continue"),
        (edited(39, 999999.0), "does not continue"),
        (order(11, 30), "records 11 and 30 does not continue"),
        (order(11, 12), "does not continue"),
        (0 * TURN, "all 40 records have the same angle"),
        (np.radians(TURN), "radians"),
        (np.random.default_rng(3).permutation(TURN), "back and forth"),
    ],
)
def test_angles_that_cannot_be_are_doubted(angles, words):
    found = journal_doubts(range(COUNT), angles, ONE, None)
    assert len(found) == 1 and words in found[0] and "\n" not in found[0]


def test_a_whole_turn_in_radians_is_doubted_with_few_records():
    turn = 30.0 * np.arange(12)
    (doubt,) = journal_doubts(range(12), np.radians(turn), ONE[:12], None)
    assert "radians" in doubt
    # A small turn is none, nor is a sweep of 6 degrees that is no whole turn.
    assert journal_doubts(range(12), turn / 60, ONE[:12], None) == []


def test_missing_records_are_named():
    left = [k for k in range(COUNT) if k not in (5, 6, 20)]
    (doubt,) = journal_doubts(left, TURN[left], ONE[:37], None)
    assert "5 to 6, and 1 more gaps" in doubt
    found = journal_doubts(range(30), TURN[:30], ONE[:30], COUNT)
    assert found == ["30 of the 40 planned records are there"]
    # Dropped and numbered anew: the step is twice as wide.
    left = [k for k in range(COUNT) if k != 12]
    (doubt,) = journal_doubts(range(39), TURN[left], ONE[:39], None)
    assert "does not continue" in doubt


WIDTH, HEIGHT = 320, 64
SCANNER = Scanner(
    Pinhole(
        fx=np.float64(200.0), fy=np.float64(200.0), cx=np.float64(159.5), cy=np.float64(31.5),
        distortion=np.zeros(5), width=WIDTH, height=HEIGHT,
    ),
    stack_lasers([LaserSheet.from_plane(np.array([-1.0, -0.03, 0.30]), 0.2)]),
    Turntable.from_axis(np.array([0.0, -1.0, 0.0]), np.zeros(3)),
)  # fmt: skip


@pytest.fixture(scope="module")
def frames():
    """A turning camera in a round room with a texture: the picture moves by 200 px a radian; a stripe at one place."""
    rng = np.random.default_rng(7)
    wall = np.interp(np.arange(0, 2000, 0.5), np.arange(0, 2001, 12), rng.uniform(30, 160, 167))
    u, step = np.arange(WIDTH), np.radians(9.0)
    off = np.stack([np.interp(900 - 200 * k * step + u + 500, np.arange(0, 2000, 0.5), wall) for k in range(COUNT)])
    off = np.repeat(off[:, None, :], HEIGHT, 1)
    stripe = 90 * np.exp(-0.5 * ((u - 200) / 1.5) ** 2)
    on, off = (np.clip(np.rint(x + rng.normal(0, 1.2, x.shape)), 0, 255).astype(np.uint8) for x in (off + stripe, off))
    return on, off


def seen_of(on, off):
    watch = FrameWatch(len(on), upright=True, brackets=False, colours=False)
    for k in range(len(on)):
        watch.look(k, on[k], off[k])
    return watch.seen


def doubts_of(on, off, angles=None, scanner=SCANNER):
    seen, own = seen_of(on, off), np.arange(len(on))
    angles = np.radians(TURN) if angles is None else angles
    found = repeated_frames(seen, own) + exchanged_frames(seen, own) + strange_frames(seen, own, own)
    found += blank_frames(seen, own)
    return found + turning_doubts(seen, own, angles, own, scanner)


def put(stack, k, frame):
    changed = stack.copy()
    changed[k] = frame
    return changed


def test_healthy_frames_give_no_doubt(frames):
    on, off = frames
    assert doubts_of(on, off) == []
    assert doubts_of(on[::2], off[::2], np.radians(TURN[::2])) == []
    # A dark room tells nothing, and frames without noise are the same by right.
    assert doubts_of(np.full_like(on, 0), np.full_like(off, 0)) == []
    # One laser-off frame for all, as somebody may want it of a table that carries the object.
    still = np.repeat(off[:1], COUNT, 0)
    assert repeated_frames(seen_of(on, still), np.arange(COUNT)) == []


def test_records_may_name_the_same_laser_off_image(frames):
    """As two lasers at each angle may, or groups of steps."""
    on, off = frames
    names = np.arange(COUNT) // 2
    off = off[2 * names]
    seen = seen_of(on, off)
    assert repeated_frames(seen, np.arange(COUNT), names) == []
    assert "are the same frame again" in repeated_frames(seen, np.arange(COUNT))[0]
    # One of the images is that of another angle.
    off = off.copy()
    off[6:8] = off[0]
    found = repeated_frames(seen_of(on, off), np.arange(COUNT), names)
    assert found == ["the laser-off frames of records 0, 1, 6 and 7 are the same frame again"]


def test_repeated_and_exchanged_frames(frames):
    on, off = frames
    assert "records 3 and 20 are the same frame again" in doubts_of(put(on, 3, on[20]), off)[0]
    assert "laser-off frames of records 3 and 20" in doubts_of(on, put(off, 3, off[20]))[0]
    assert "frame of record 5 are the same" in " ".join(doubts_of(put(on, 5, off[5]), off))
    swapped = doubts_of(put(on, 9, off[9]), put(off, 9, on[9]))
    assert "laser on and laser off are exchanged in record 9" in swapped
    assert any("on and off are exchanged" in doubt for doubt in doubts_of(off, on))


@pytest.mark.parametrize("sides", [(0, 1), (0,), (1,)])
def test_frames_of_another_record_or_brightness(frames, sides):
    stacks = [stack.copy() for stack in frames]
    for side in sides:
        stacks[side][[6, 25]] = stacks[side][[25, 6]]
    assert any(re.search(r"records 6\b.* 25\b", doubt) for doubt in doubts_of(*stacks))
    dim = [stack.copy() for stack in frames]
    for side in sides:
        dim[side][8] = dim[side][8] // 3
    assert any("record 8" in doubt for doubt in doubts_of(*dim))


@pytest.mark.parametrize("side", [0, 1])
def test_a_block_of_zeros(frames, side):
    """As in a raw shard whose disk has lost a block: too little for the brightness of the whole frame."""
    stacks = [stack.copy() for stack in frames]
    stacks[side].reshape(COUNT, -1)[11, 1000:3000] = 0
    found = doubts_of(*stacks)
    assert any("record 11 has up to 5 rows of zeros" in doubt for doubt in found)
    assert not any(f"record {k}" in doubt or f"records {k}" in doubt for doubt in found for k in (10, 12))


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("damage", ["mirrored", "upside down", "a bit", "a part"])
def test_one_frame_of_a_pair_that_is_damaged(frames, side, damage):
    rng = np.random.default_rng(1)
    # A room with bare walls, where the median of the difference says nothing, and a few things before them.
    bare = np.rint(120 + rng.normal(0, 1.2, frames[0].shape))
    bare[:, 10:50, 60:90] -= 50
    stripe = 90 * np.exp(-0.5 * ((np.arange(WIDTH) - 200) / 1.5) ** 2)
    stacks = [np.rint(bare + stripe).astype(np.uint8), np.rint(bare + rng.normal(0, 1.2, bare.shape)).astype(np.uint8)]
    assert strange_frames(seen_of(*stacks), np.arange(COUNT), np.arange(COUNT)) == []
    frame = stacks[side][17].copy()
    part = np.roll(frame.reshape(-1)[:7000], 30)
    stacks[side][17] = {
        "mirrored": frame[:, ::-1], "upside down": frame[::-1, ::-1], "a bit": frame ^ 16,
        "a part": np.concatenate([part, frame.reshape(-1)[7000:]]).reshape(frame.shape),
    }[damage]  # fmt: skip
    found = strange_frames(seen_of(*stacks), np.arange(COUNT), np.arange(COUNT))
    assert any("record 17" in doubt for doubt in found)


def test_angles_that_the_picture_contradicts(frames):
    on, off = frames
    moved = np.radians(edited(13, TURN[13] + 5.0))
    assert any("record 13 shows another place" in doubt for doubt in doubts_of(on, off, moved))


def test_an_axis_that_lies_in_the_image(frames):
    """As a person may write it by mistake, with the usual `up`: no motion is expected, and there is one."""
    lying = dataclasses.replace(SCANNER, turntable=Turntable.from_axis(np.array([1.0, 0.0, 0.0]), np.zeros(3)))
    assert any("does not stand upright" in doubt for doubt in doubts_of(*frames, scanner=lying))


def test_a_bare_stretch_is_not_another_place(frames):
    """Where the picture does not continue around a record either, nothing is known of that record."""
    bare = [stack.copy() for stack in frames]
    noise = np.random.default_rng(4).normal(90, 1.2, bare[0][10:17].shape)
    for stack in bare:
        stack[10:17] = np.rint(noise).astype(np.uint8)
    assert not any(
        "another place" in doubt
        for doubt in turning_doubts(seen_of(*bare), np.arange(COUNT), np.radians(TURN), np.arange(COUNT), SCANNER)
    )


def test_the_mosaic_and_the_colour_of_the_laser(frames):
    on, off = (stack.astype(np.float64) for stack in frames)
    gains = np.ones((HEIGHT, WIDTH))
    gains[0::2, 0::2], gains[1::2, 1::2] = 0.7, 0.5
    laser = np.where((np.arange(HEIGHT) % 2 == 0)[:, None] & (np.arange(WIDTH) % 2 == 0), 1.0, 0.05)
    mosaic = [np.rint(x).astype(np.uint8) for x in (off * gains + np.maximum(on - off, 0) * laser, off * gains)]

    def doubts(stacks, pixel_format, colour="red"):
        sweep = Sweep(*stacks, np.radians(TURN), pixel_format=pixel_format, lasers=(LaserLine(colour=colour),))
        return " ".join(header_doubts(sweep, seen_of(*stacks), SCANNER))

    assert doubts(mosaic, "bayer_rggb8") == "" and doubts(frames, "mono8") == ""
    assert "mosaic of colours, and pixel_format" in doubts(mosaic, "mono8")
    assert "no mosaic" in doubts(frames, "bayer_rggb8")
    assert "another order" in doubts(mosaic, "bayer_grbg8")
    assert "is blue in the frames" in doubts(mosaic, "bayer_bggr8")
    assert "is red in the frames" in doubts(mosaic, "bayer_rggb8", "green")
