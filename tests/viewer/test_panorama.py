"""Standing in a panorama: what the page shows where, and pictures that are none."""

import dataclasses

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.reconstruction import Stations
from jaxscan.viewer import Panorama, serve_clouds
from jaxscan.vision import decode_image, encode_jpeg, encode_picture_png, read_panorama
from jaxscan.web import open_address

from ..browser.driver import WIDE as WINDOW
from ..browser.driver import Looks


WIDE, HIGH, ABOVE = 1000, 400, 50
HEIGHT = WINDOW[1]
TURNED = np.array([[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
"""T_room_scanner: the scanner's x axis lies along y of the room."""


def directions():
    """A panorama whose red says the azimuth and whose green the elevation: whole turn, 72 to -72 degrees."""
    red, green = np.meshgrid(np.linspace(0, 255, WIDE), np.linspace(255, 0, HIGH))
    return np.stack([red, green, np.full_like(red, 60)], -1).round().astype(np.uint8)


def described(full=WIDE, above=ABOVE):
    sizes = f'GPano:FullPanoWidthPixels="{full}" GPano:FullPanoHeightPixels="{full // 2}"'
    return f'<x {sizes} GPano:CroppedAreaTopPixels="{above}"/>'


@pytest.mark.parametrize("encode", [encode_jpeg, encode_picture_png])
def test_a_picture_is_placed_by_its_metadata(encode):
    read = read_panorama(encode(directions(), xmp=described(above=20)), name="room.jpg")
    pixel = 2 * np.pi / WIDE
    assert (read.top, read.bottom) == pytest.approx((np.pi / 2 - 20 * pixel, np.pi / 2 - 420 * pixel))
    assert decode_image(read.jpeg, name="a", rank=3, size=(WIDE, HIGH)).shape == (HIGH, WIDE, 3)


def test_without_metadata_the_horizon_is_in_the_middle():
    read = read_panorama(encode_jpeg(directions()), name="room.jpg")
    assert (read.top, read.bottom) == pytest.approx((0.4 * np.pi, -0.4 * np.pi))


def test_a_picture_made_smaller_keeps_its_place():
    """Programs that shrink pictures leave their metadata as they are."""
    small = np.ascontiguousarray(directions()[::2, ::2])
    read = read_panorama(encode_jpeg(small, xmp=described()), name="room.jpg")
    assert (read.top, read.bottom) == pytest.approx((0.4 * np.pi, -0.4 * np.pi))


def test_wide_ones_are_made_smaller():
    wide = np.zeros((20, 9000, 3), np.uint8)
    read = read_panorama(encode_jpeg(wide), name="room.jpg")
    assert decode_image(read.jpeg, name="a", rank=3, size=None).shape == (9, 4096, 3)
    assert read.top - read.bottom == pytest.approx(20 * 2 * np.pi / 9000)


HALF = "GPano:CroppedAreaImageWidthPixels"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no picture",
        encode_jpeg(np.zeros((300, 400, 3), np.uint8)),
        encode_picture_png(np.zeros((100, 400), np.uint8)),
        encode_jpeg(np.zeros((100, 400, 3), np.uint8), xmp=described(400, above=150)),
        encode_jpeg(np.zeros((100, 400, 3), np.uint8))[:200],
        # A telephone's half turn.
        encode_jpeg(np.zeros((100, 400, 3), np.uint8), xmp=described(800).replace("/>", f' {HALF}="400"/>')),
    ],
)
def test_what_is_no_panorama_is_refused(data):
    with pytest.raises(CaptureError, match=r"^room\.jpg: "):
        read_panorama(data, name="room.jpg")


@pytest.fixture
def looks(browser, room):
    profiles = len(room.cloud.valid)
    stations = Stations(np.zeros(profiles, np.int32), TURNED[None], np.zeros((1, 6, 6)))
    placed = dataclasses.replace(room.cloud, stations=stations)
    seen = Panorama(*read_panorama(encode_jpeg(directions(), quality=98), name="room.jpg"))
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room._replace(cloud=placed, panorama=seen)]):
        looks = Looks(browser)
        looks.open(address.url(with_token=True))
        looks.until(lambda: looks.colours("cloud") > 20)
        yield looks
        browser.get("about:blank")


def colour_at(looks, x=None, y=HEIGHT / 2):
    """The colour of the page's picture [px]; in the middle of what the panel leaves free."""
    script = """
      const middle = document.getElementById("panel").getBoundingClientRect().left / 2;
      const from = document.getElementById("cloud"), copy = document.createElement("canvas");
      copy.width = from.width; copy.height = from.height;
      const pen = copy.getContext("2d");
      pen.drawImage(from, 0, 0);
      return Array.from(pen.getImageData(arguments[0] ?? middle, arguments[1], 1, 1).data);"""
    return looks.driver.execute_script(script, x, y)


def seen_at(looks, x=None, y=HEIGHT / 2):
    """Azimuth and elevation of a place of the page's picture, in the scanner's frame [degrees]."""
    red, green, *_ = colour_at(looks, x, y)
    return 180 - 360 * red / 255, -72 + 144 * green / 255


def test_one_stands_in_it(looks):
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    looks.click("station-1")
    # JavaScript's text: the part of the panel is folded.
    said = "return document.getElementById('shown').textContent"
    looks.until(lambda: looks.driver.execute_script(said) == "a panorama is shown")
    # The page looks along x of the room, which is -y of the scanner.
    assert seen_at(looks) == pytest.approx((-90, 0), abs=3)
    looks.at("cloud").send_keys("\ue012" * 5)
    # Five steps of 0.08 rad to the left.
    looks.until(lambda: seen_at(looks)[0] > -80)
    assert seen_at(looks) == pytest.approx((-90 + np.degrees(0.4), 0), abs=3)
    looks.click("photographs")
    looks.until(lambda: looks.driver.execute_script(said).endswith("points shown"))
    looks.click("photographs")
    looks.until(lambda: looks.driver.execute_script(said) == "a panorama is shown")
    # What is under the pointer stays there while the picture is dragged.
    held = seen_at(looks, 300, 500)
    pointer = ActionBuilder(looks.driver)
    pointer.pointer_action.move_to_location(300, 500).pointer_down().move_by(60, 20).move_by(100, 20).pointer_up()
    pointer.perform()
    looks.until(lambda: seen_at(looks, 300, 500)[0] > held[0] + 5)
    assert seen_at(looks, 460, 540) == pytest.approx(held, abs=3)
    # One looks closer, and does not leave; other colours are those of points.
    apart = seen_at(looks, 100)[0] - seen_at(looks)[0]
    looks.at("cloud").send_keys("+" * 5)
    looks.until(lambda: seen_at(looks, 100)[0] - seen_at(looks)[0] < 0.6 * apart)
    colour = "const by = document.getElementById('by'); by.value = arguments[0]; by.dispatchEvent(new Event('change'));"
    looks.driver.execute_script(colour, "height")
    looks.until(lambda: looks.driver.execute_script(said).endswith("points shown"))
    looks.driver.execute_script(colour, "photograph")
    looks.until(lambda: looks.driver.execute_script(said) == "a panorama is shown")
    looks.at("cloud").send_keys("o")
    looks.until(lambda: looks.driver.execute_script(said).endswith("points shown"))
    looks.at("cloud").send_keys("1")
    looks.until(lambda: looks.driver.execute_script(said) == "a panorama is shown")
    # A step aside leads out of it.
    looks.at("cloud").send_keys("\ue008" + 2 * "\ue014")
    looks.until(lambda: looks.driver.execute_script(said).endswith("points shown"))
    # Dark pictures are brightened as dark clouds are, bright ones are left.
    gain = """
        const done = arguments[1], canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
        pen.fillStyle = arguments[0];
        pen.fillRect(0, 0, canvas.width, canvas.height);
        import("./panorama.js").then(({ Panorama }) => done(Panorama.prototype.gain(canvas)));"""
    found = [looks.driver.execute_async_script(gain, colour) for colour in ("#28281e", "#fafafa", "#020202")]
    assert found == pytest.approx([235 / 40, 1, 6])
    assert looks.complaints() == []
