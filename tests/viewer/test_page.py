"""The viewer in a real browser."""

import base64
import json
import time
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest
from scipy import ndimage

from jaxscan.viewer import serve_clouds
from jaxscan.web import open_address

from ..browser.driver import NARROW, WIDE, Looks
from ..cli.conftest import run as run


# Where points are close together, as shares of the picture, from left to right: clicks there hit something.
DENSE = """
  const from = document.getElementById("cloud"), copy = document.createElement("canvas"), found = [];
  copy.width = from.width; copy.height = from.height;
  const pen = copy.getContext("2d");
  pen.drawImage(from, 0, 0);
  const data = new Uint32Array(pen.getImageData(0, 0, copy.width, copy.height).data.buffer), empty = data[0];
  for (let x = 20; x < copy.width - 360; x += 10) {
    let best = 0, at = 0;
    for (let y = 20; y < copy.height - 20; y += 10) {
      let full = 0;
      for (let k = -8; k <= 8; k++) for (let l = -8; l <= 8; l++) full += data[(y + k) * copy.width + x + l] !== empty;
      if (full > best) { best = full; at = y; }
    }
    if (best > 30) found.push([x / copy.width, at / copy.height]);
  }
  return found;"""


@pytest.fixture
def looks(browser, url):
    looks = Looks(browser)
    browser.get("about:blank")
    yield looks
    browser.get("about:blank")


def tap(looks, x, y):
    """A click, at shares of the picture."""
    looks.driver.execute_script(
        """
        const at = document.getElementById("cloud").getBoundingClientRect();
        const [x, y] = [at.left + arguments[0] * at.width, at.top + arguments[1] * at.height];
        for (const kind of ["pointerdown", "pointerup"])
          document.getElementById("cloud").dispatchEvent(new PointerEvent(kind,
            { bubbles: true, pointerId: 1, clientX: x, clientY: y, buttons: kind === "pointerdown" ? 1 : 0 }));
        """,
        x,
        y,
    )


@pytest.fixture
def opened(looks, url):
    """The page with all its points, at a desk."""
    looks.open(url)
    looks.until(lambda: looks.colours("cloud") > 20)
    count, since = "", time.monotonic()
    while time.monotonic() - since < 1.0:
        shown = looks.driver.execute_script("return document.getElementById('shown').textContent")
        if shown != count:
            count, since = shown, time.monotonic()
    return looks


def wait_for_answer(looks):
    looks.until(lambda: looks.text("message") not in ("measuring …", ""))


def test_two_clicks_give_what_the_command_prints(opened, run):
    opened.at("distance").click()
    opened.until(lambda: opened.text("message").startswith("Click two places"))
    dense = opened.driver.execute_script(DENSE)
    assert len(dense) > 10
    found = ""
    # Some places have too few points within 20 mm, which the page says.
    for x, y in [place for pair in zip(dense, reversed(dense), strict=True) for place in pair][:20]:
        tap(opened, x, y)
        wait_for_answer(opened)
        found = opened.text("measured")
        if found:
            break
    assert found, opened.text("message")
    title = opened.driver.execute_script("return document.querySelector('#measured li').title")
    printed = run(*title.split()[1:]).out.splitlines()
    assert found == "; ".join(printed)
    opened.at("undo").click()
    opened.until(lambda: not opened.text("measured"))
    assert opened.complaints() == []


def test_colours_a_section_and_what_stands_where(opened):
    before = opened.colours("cloud")
    opened.driver.execute_script(
        "const by = document.getElementById('by'); by.value = 'height'; by.dispatchEvent(new Event('change'));"
    )
    opened.until(lambda: opened.at("scale").is_displayed())
    assert opened.text("scale-words").endswith(" m")
    opened.until(lambda: opened.colours("cloud") != before)
    # A box without anything in it.
    opened.driver.execute_script(
        """for (const id of ["x-from", "x-to"]) {
             const slider = document.getElementById(id);
             slider.value = slider.min;
             slider.dispatchEvent(new Event("input"));
           }
           document.getElementById("section").click();"""
    )
    opened.until(lambda: opened.colours("cloud") == 1)
    opened.driver.execute_script("document.getElementById('section').click()")
    opened.until(lambda: opened.colours("cloud") > 20)
    # Names of files are text.
    assert "<b>grey</b>" in opened.driver.execute_script("return document.getElementById('clouds').textContent")


def handles(looks):
    """Where the handles of the section are [px]: blue spots that are drawn over the cloud."""
    png = looks.driver.execute_script("return document.getElementById('marks').toDataURL()").partition(",")[2]
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(png), np.uint8), cv2.IMREAD_UNCHANGED)
    blue = np.all(picture == (255, 179, 111, 255), axis=-1)
    # Letters are written on the spots, and lines lead through them.
    spots, count = ndimage.label(ndimage.binary_opening(ndimage.binary_closing(blue, np.ones((5, 5))), np.ones((7, 7))))
    return [(x, y) for y, x in ndimage.center_of_mass(spots > 0, spots, range(1, count + 1))]


def test_a_side_of_the_section_is_dragged(opened):
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    opened.driver.execute_script("document.getElementById('section').click()")
    opened.until(lambda: len(handles(opened)) >= 3)
    sides = "return Array.from(document.querySelectorAll('#box input'), (one) => Number(one.value))"
    before = opened.driver.execute_script(sides)
    panel = opened.driver.execute_script("return document.getElementById('panel').getBoundingClientRect().left")
    x, y = min(place for place in handles(opened) if place[0] < panel - 60)
    way = np.array([WIDE[0] / 2 - x, WIDE[1] / 2 - y])
    dx, dy = (round(one) for one in 60 * way / np.linalg.norm(way))
    pointer = ActionBuilder(opened.driver)
    pointer.pointer_action.move_to_location(round(x), round(y)).pointer_down()
    pointer.pointer_action.move_by(dx // 2, dy // 2).move_by(dx - dx // 2, dy - dy // 2).pointer_up()
    pointer.perform()
    after = opened.driver.execute_script(sides)
    moved = [k for k in range(6) if abs(after[k] - before[k]) > 0.02]
    # Inwards: "from" grew, or "to" shrank; and nothing was measured.
    assert len(moved) == 1 and (after[moved[0]] > before[moved[0]]) == (moved[0] % 2 == 0)
    # The side moves along its own axis, to which the pointer's way is a little oblique.
    assert min(np.hypot(a - x - dx, b - y - dy) for a, b in handles(opened)) < 30
    assert opened.text("measured") == ""
    assert opened.complaints() == []


def test_deviations_need_a_plane(opened):
    opened.driver.execute_script(
        "const by = document.getElementById('by'); by.value = 'deviation'; by.dispatchEvent(new Event('change'));"
    )
    opened.until(lambda: opened.text("message").startswith("Measure the flatness of a place first"))


def test_the_room_by_the_keyboard_and_over_a_reload(opened):
    opened.at("room").send_keys("\ue007")
    opened.until(lambda: "height" in opened.text("measured"))
    opened.driver.refresh()
    opened.until(lambda: "height" in opened.text("measured"))
    for _ in range(3):
        opened.at("cloud").send_keys("u")
    opened.until(lambda: not opened.text("measured"))
    opened.at("cloud").send_keys("f")
    opened.until(lambda: opened.text("message").startswith("Click a flat place"))


def test_a_telephone(looks, url):
    looks.open(url, NARROW)
    looks.until(lambda: looks.colours("cloud") > 20)
    wide = looks.driver.execute_script("return document.documentElement.scrollWidth")
    assert wide <= NARROW[0]
    top = looks.driver.execute_script("return document.getElementById('panel').getBoundingClientRect().top")
    assert top > 0.5 * NARROW[1]


def test_without_webgl_the_page_says_what_to_do(looks, url):
    script = """
        HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype.getContext, {
          apply: (get, canvas, asked) => asked[0] === "webgl" ? null : get.apply(canvas, asked),
        })
    """
    added = looks.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": script})
    try:
        looks.open(url)
        looks.until(lambda: "Switch hardware acceleration on" in looks.text("no-webgl"))
    finally:
        looks.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)


def test_requests_that_mean_nothing(url):
    def status(path):
        try:
            with urllib.request.urlopen(url.rstrip("/") + path) as answer:
                return answer.status
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code

    assert status("/points/0/0") == 200 and status("/colours/1/0?by=sigma") == 200
    for path in ("/points/9/0", "/points/0/999999", "/points/0/x", "/colours/0/0?by=all", "/colours/0/0", "/../x"):
        assert status(path) == 404, path
    for plane in ("0", "-1", "x", ""):
        assert status(f"/scale?by=deviation&page=nobody&plane={plane}") == 404
    with urllib.request.urlopen(url + "scene") as answer:
        scene = json.loads(answer.read())
    assert [cloud["name"] for cloud in scene["clouds"]][1] == "<b>grey</b>"


def test_a_wide_address_needs_its_token(room):
    address = open_address("0.0.0.0", 0, option="--web-port")
    with serve_clouds(address, [room]):
        here = f"http://127.0.0.1:{address.port}"
        for path in ("/", "/scene", "/points/0/0", "/socket"):
            for token in ("", "?token=wrong"):
                with pytest.raises(urllib.error.HTTPError) as refused:
                    urllib.request.urlopen(here + path + token)
                with refused.value:
                    assert refused.value.code == 403


def test_the_products_of_a_project_are_listed_as_they_are_now(looks, room):
    rows = [("cloud/one", "done", ""), ("mesh/one", "stale", "settings changed")]
    rows += [("cloud/two", "failed", "no <b>laser</b>")]
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room], products=lambda: rows):
        looks.open(address.url())
        looks.until(lambda: looks.at("products-part").is_displayed())
        looks.driver.execute_script("document.getElementById('products-part').open = true")
        looks.until(lambda: looks.text("products-words") == "1 done, 1 stale, 1 failed")
        listed = "failed cloud/two\nno <b>laser</b>\nstale mesh/one\nsettings changed\ndone cloud/one"
        assert looks.text("products") == listed
        rows[:] = [("cloud/one", "done", "")]
        looks.click("look-again")
        looks.until(lambda: looks.text("products-words") == "1 done")
