"""The viewer in a real browser."""

import base64
import json
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

from jaxscan.errors import MeasurementError
from jaxscan.viewer import serve_clouds
from jaxscan.viewer.session import Session
from jaxscan.viewer.site import AT_ONCE
from jaxscan.web import in_browser, open_address

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
    # The next page is another person's, with an empty list.
    browser.execute_script("if (location.origin !== 'null') sessionStorage.clear()")
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
    """The page with all its points, those too that are seen from behind, at a desk."""
    looks.open(url)
    looks.until(lambda: looks.colours("cloud") > 20)
    looks.click("backs")
    settle(looks)
    return looks


def settle(looks):
    """Waits until the picture stays as it is: points and their colours come one piece after the other."""
    last, since = picture(looks, "cloud"), time.monotonic()
    while time.monotonic() - since < 1.0:
        seen = picture(looks, "cloud")
        if not np.array_equal(seen, last):
            last, since = seen, time.monotonic()


def listed(looks):
    """The list of what was measured, without its buttons."""
    script = "return Array.from(document.querySelectorAll('#measured .words'), (one) => one.textContent)"
    return looks.driver.execute_script(script)


def colour_by(looks, what):
    script = "const by = document.getElementById('by'); by.value = arguments[0]; by.dispatchEvent(new Event('change'));"
    looks.driver.execute_script(script, what)


def measure_somewhere(looks, kind, first=0):
    """Clicks until there is a measurement: some places have too few points, which the page says.

    Places come from the left and from the right in turn, from the left first; with `first` 1 from the right.
    """
    before = listed(looks)
    looks.at(kind).click()
    looks.until(lambda: looks.text("message").startswith("Click"))
    dense = looks.driver.execute_script(DENSE)
    assert len(dense) > 10
    for x, y in [place for pair in zip(dense, reversed(dense), strict=True) for place in pair][first:20]:
        tap(looks, x, y)
        wait_for_answer(looks)
        if listed(looks) != before:
            return
    raise AssertionError(looks.text("message"))


def picture(looks, name):
    """What a canvas shows, [row, column, 4], BGRA."""
    address = looks.driver.execute_script("return document.getElementById(arguments[0]).toDataURL()", name)
    png = base64.b64decode(address.partition(",")[2])
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)


def wait_for_answer(looks):
    looks.until(lambda: looks.text("message") not in ("measuring …", ""))


def test_two_clicks_give_what_the_command_prints(opened, run):
    assert not opened.at("csv").is_enabled()
    measure_somewhere(opened, "distance")
    title = opened.driver.execute_script("return document.querySelector('#measured li').title")
    printed = run(*title.split()[1:]).out.splitlines()
    assert listed(opened) == ["; ".join(printed)]
    # The command can be had without a pointer to rest, and the entry be taken out.
    opened.driver.execute_script("document.querySelector('#measured button').click()")
    opened.until(lambda: opened.text("message").endswith(title))
    opened.driver.execute_script("document.querySelector('#measured li button:last-child').click()")
    opened.until(lambda: listed(opened) == [] and not opened.at("csv").is_enabled())
    assert opened.complaints() == []


def test_colours_a_section_and_what_stands_where(opened):
    before = opened.colours("cloud")
    colour_by(opened, "height")
    opened.until(lambda: opened.at("scale").is_displayed())
    assert opened.text("scale-words").endswith(" m")
    opened.until(lambda: opened.colours("cloud") != before)
    # A box without anything in it.
    opened.driver.execute_script(
        """for (const id of ["x-from", "x-to"]) {
             const slider = document.getElementById(id);
             slider.value = 0.1;
             slider.dispatchEvent(new Event("input"));
           }
           document.getElementById("section").click();"""
    )
    opened.until(lambda: opened.colours("cloud") == 1)
    opened.driver.execute_script("document.getElementById('section').click()")
    opened.until(lambda: opened.colours("cloud") > 20)
    # One that leaves nothing out, however it is turned, and a part of the room that turns with it.
    script = """
        for (const [id, value] of arguments[0]) {
          const slider = document.getElementById(id);
          slider.value = value;
          slider.dispatchEvent(new Event("input"));
        }"""
    settle(opened)
    whole = np.count_nonzero(picture(opened, "cloud")[..., 1] > 40)
    opened.driver.execute_script(script, [["x-from", -99], ["x-to", 99], ["turn", 30]])
    opened.driver.execute_script("document.getElementById('section').click()")
    opened.until(lambda: np.count_nonzero(picture(opened, "cloud")[..., 1] > 40) == whole)
    opened.driver.execute_script(script, [["x-from", 0.1]])
    opened.until(lambda: np.count_nonzero(picture(opened, "cloud")[..., 1] > 40) < 0.9 * whole)
    settle(opened)
    half = picture(opened, "cloud")
    opened.driver.execute_script(script, [["turn", -30]])
    opened.until(lambda: (picture(opened, "cloud") != half).any())
    # Names of files are text.
    assert "<b>grey" in opened.driver.execute_script("return document.getElementById('clouds').textContent")


def lit(looks):
    """Pixels of the cloud's canvas that show points."""
    return np.count_nonzero(picture(looks, "cloud")[..., 1] > 40)


def test_what_is_seen_from_behind_is_hidden_and_is_not_picked(opened):
    # As a page begins.
    opened.driver.refresh()
    opened.until(lambda: opened.colours("cloud") > 20)
    settle(opened)
    assert opened.at("backs").is_selected() and opened.at("backs-part").is_displayed()
    hidden = lit(opened)
    opened.at("cloud").send_keys("b")
    opened.until(lambda: not opened.at("backs").is_selected())
    settle(opened)
    assert lit(opened) > 1.2 * hidden
    # Places that only backs cover: a click there meets something only while they are shown.
    back = picture(opened, "cloud")[..., 1] > 40
    opened.click("backs")
    settle(opened)
    assert abs(lit(opened) - hidden) < 0.02 * hidden
    front = ndimage.binary_dilation(picture(opened, "cloud")[..., 1] > 40, iterations=45)
    free = opened.driver.execute_script("return document.getElementById('panel').getBoundingClientRect().left")
    rows, columns = np.nonzero(ndimage.uniform_filter(back.astype(float), 25) * ~front)
    inside = columns < free
    assert inside.any()
    y, x = np.median(rows[inside]), np.median(columns[inside])
    y, x = min(zip(rows[inside], columns[inside], strict=True), key=lambda one: abs(one[0] - y) + abs(one[1] - x))
    tap(opened, x / back.shape[1], y / back.shape[0])
    opened.until(lambda: opened.text("message") == "There is no point: click on the cloud.")
    assert opened.complaints() == []


def handles(looks):
    """Where the handles of the section are [px]: blue spots that are drawn over the cloud."""
    blue = np.all(picture(looks, "marks") == (255, 179, 111, 255), axis=-1)
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
    way = np.array([panel / 2 - x, WIDE[1] / 2 - y])
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


def test_deviations_are_those_from_the_last_plane(opened):
    colour_by(opened, "deviation")
    opened.until(lambda: opened.text("message").startswith("Measure the flatness of a place first"))
    chosen = "return document.getElementById('by').value"
    assert opened.driver.execute_script(chosen) == "photograph"
    measure_somewhere(opened, "flatness")
    colour_by(opened, "deviation")
    opened.until(lambda: opened.at("scale").is_displayed())
    first = opened.text("scale-words")
    measure_somewhere(opened, "flatness", 1)
    opened.until(lambda: opened.text("scale-words") != first)
    opened.click("undo")
    opened.until(lambda: opened.text("scale-words") == first)
    opened.click("clear")
    opened.until(lambda: not opened.at("scale").is_displayed())
    assert opened.driver.execute_script(chosen) == "photograph"


def test_clouds_side_by_side_have_names_and_may_all_be_hidden(opened):
    assert opened.colours("marks") == 1
    opened.driver.execute_script("document.getElementById('apart').click()")
    opened.until(lambda: opened.colours("marks") > 1)
    opened.click("room")
    opened.until(lambda: "<b>grey: " in opened.text("measured"))
    opened.driver.execute_script("for (const one of document.querySelectorAll('#clouds input')) one.click()")
    opened.until(lambda: opened.text("loading") == "no cloud is shown")
    opened.click("room")
    opened.until(lambda: opened.text("message") == "No cloud is shown.")
    assert opened.colours("marks") == 1 and opened.complaints() == []


def test_a_browser_that_takes_its_graphics_away_and_gives_them_again(looks, url):
    looks.open(url)
    looks.until(lambda: looks.colours("cloud") > 20)
    script = """
        window.taken ??= document.getElementById("cloud").getContext("webgl").getExtension("WEBGL_lose_context");
        window.taken[arguments[0]]();"""
    looks.driver.execute_script(script, "loseContext")
    looks.until(lambda: looks.at("lost").is_displayed())
    looks.driver.execute_script(script, "restoreContext")
    looks.until(lambda: looks.colours("cloud") > 20)
    assert not looks.at("lost").is_displayed()


def test_another_server_at_the_same_address_shows_its_own_clouds(looks, room):
    address = open_address("127.0.0.1", 0, option="--web-port")
    title = "return document.getElementById('clouds').textContent"
    with serve_clouds(address, [room]):
        looks.open(address.url(with_token=True))
        looks.until(lambda: looks.colours("cloud") > 20)
    looks.until(lambda: looks.text("message").startswith("No connection"))
    colour_by(looks, "height")
    looks.until(lambda: "the colours stay" in looks.text("message") or "trying again" in looks.text("message"))
    looks.until(lambda: looks.driver.execute_script("return document.getElementById('by').value") == "photograph")
    anew = open_address("127.0.0.1", address.port, option="--web-port")
    with serve_clouds(anew, [room._replace(name="other")]):
        looks.until(lambda: "the whole address that the terminal shows" in looks.text("message"))
        first = looks.driver.current_window_handle
        looks.driver.switch_to.new_window("tab")
        looks.open(anew.url(with_token=True))
        looks.driver.close()
        looks.driver.switch_to.window(first)
        looks.until(lambda: looks.driver.execute_script(title).strip() == "other")
        looks.driver.get("about:blank")


def test_a_page_that_goes_while_something_is_measured_is_no_news(looks, url, caplog, monkeypatch):
    begun = threading.Event()

    def slowly(*_):
        begun.set()
        time.sleep(0.5)
        return {}

    looks.open(url)
    looks.until(lambda: looks.colours("cloud") > 20)
    with monkeypatch.context() as patched:
        patched.setattr(Session, "begin", slowly)
        looks.click("room")
        assert begun.wait(10)
        looks.driver.get("about:blank")
        time.sleep(0.7)
    assert caplog.text == ""


def test_escape_ends_a_long_measurement_and_a_click_does_not(opened, monkeypatch):
    go, running = threading.Event(), []

    def slowly(*_):
        running.append(1)
        go.wait(20)
        running.pop()
        raise MeasurementError("too late")

    with monkeypatch.context() as patched:
        patched.setattr("jaxscan.viewer.session.measure_sides", slowly)
        try:
            opened.click("room")
            opened.until(lambda: running and "ends it" in opened.text("seconds"))
            opened.at("cloud").send_keys("\ue00c")
            opened.until(lambda: opened.text("message") == "Ended: what went on was not measured.")
            # A measurement that nobody waits for goes on; a click does not wait for it, and others do not pile up.
            for _ in range(4):
                opened.click("room")
            opened.click("room")
            opened.until(lambda: opened.text("message").startswith("4 measurements go on"))
            assert len(running) == AT_ONCE
            opened.click("undo")
            measure_somewhere(opened, "point")
            assert len(listed(opened)) == 1
        finally:
            go.set()
    opened.until(lambda: not running)
    time.sleep(0.3)
    assert len(listed(opened)) == 1 and "too late" not in opened.text("message")
    assert opened.complaints() == []


def saved(looks, name):
    """What a button saves: the name of the file, and its bytes."""
    script = """
        const [id, done] = arguments, make = URL.createObjectURL, click = HTMLAnchorElement.prototype.click;
        let blob = null;
        URL.createObjectURL = (one) => { blob = one; return make(one); };
        HTMLAnchorElement.prototype.click = function () {
          URL.createObjectURL = make; HTMLAnchorElement.prototype.click = click;
          const reader = new FileReader();
          reader.onload = () => done([this.download, reader.result.split(",")[1]]);
          reader.readAsDataURL(blob);
        };
        document.getElementById(id).click();"""
    file, text = looks.driver.execute_async_script(script, name)
    return file, base64.b64decode(text)


def test_bearings_the_surface_and_what_is_saved(opened, room):
    # Names, axes and a scale bar.
    assert opened.text("caption").endswith(f" · {2 * int(room.cloud.valid.sum()):,} points")
    assert opened.text("bar-of-scale").split()[1] in ("m", "cm") and opened.colours("axes") > 3
    # From above the walls lie along the picture: its upper and its left edge are full of points.
    opened.click("above")
    settle(opened)
    seen = picture(opened, "cloud")[..., 1] > 40
    rows, columns = np.nonzero(seen)
    top, left = np.percentile(rows, 1), np.percentile(columns, 1)
    assert np.ptp(columns[rows < top + 12]) > 0.7 * np.ptp(columns)
    assert np.ptp(rows[columns < left + 12]) > 0.7 * np.ptp(rows)
    opened.click("outside")
    settle(opened)
    # The surface closes the gaps between the points, and edges are shaded unless that is not wanted.
    before = lit(opened)
    opened.click("surface")
    opened.until(lambda: lit(opened) > 1.2 * before)
    opened.until(lambda: opened.colours("cloud") > 200)
    settle(opened)
    shaded = picture(opened, "cloud")
    opened.click("shades")
    opened.until(lambda: (picture(opened, "cloud") != shaded).any())
    settle(opened)
    plain = picture(opened, "cloud")
    assert (plain[..., :3] >= shaded[..., :3]).all() and (plain > shaded).any()
    # A click between the profiles means a point, now that there is a surface.
    measure_somewhere(opened, "point")
    file, png = saved(opened, "picture")
    assert file == "view.png" and cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).shape[:2] == WIDE[::-1]
    # A box of the section: its volume, and its points as a file.
    opened.driver.execute_script("for (const one of document.querySelectorAll('details')) one.open = true")
    opened.click("volume")
    opened.until(lambda: "is open" in opened.text("message"))
    opened.driver.execute_script(
        """for (const end of ["from", "to"]) for (const axis of ["x", "y", "z"]) {
             const slider = document.getElementById(`${axis}-${end}`);
             slider.value = Number(slider.value) + (end === "to" ? -0.3 : 0.1);
             slider.dispatchEvent(new Event("input"));
           }"""
    )
    opened.click("volume")
    opened.until(lambda: "m³" in opened.text("measured"))
    count = int(listed(opened)[-1].split(", ")[2].split()[0].replace(",", ""))
    file, ply = saved(opened, "save-section")
    head, _, body = ply.partition(b"end_header\n")
    # The room's cloud is there twice.
    assert file == "section.ply" and f"element vertex {count}\n".encode() in head and len(body) == 27 * count
    assert 0 < count < 2 * room.cloud.valid.sum()
    assert opened.complaints() == []


def test_heights_angles_areas_and_how_points_are_drawn(opened):
    for kind, unit in (("height", " mm"), ("angle", " degrees")):
        measure_somewhere(opened, kind)
        assert unit in listed(opened)[-1]
    opened.click("area")
    opened.until(lambda: opened.text("message").startswith("Click the corners"))
    dense = opened.driver.execute_script(DENSE)
    assert not opened.at("close-outline").is_displayed()
    for x, y in dense[:: max(1, len(dense) // 8)]:
        tap(opened, x, y)
        wait_for_answer(opened)
        if opened.at("close-outline").is_displayed():
            break
    opened.click("close-outline")
    opened.until(lambda: "m²" in listed(opened)[-1])
    _, text = saved(opened, "json")
    assert [one["what"] for one in json.loads(text)["measured"]] == ["height", "angle", "area"]
    opened.driver.execute_script("for (const one of document.querySelectorAll('details')) one.open = true")
    slide = """const one = document.getElementById(arguments[0]);
        one.value = arguments[1];
        one.dispatchEvent(new Event("input"));"""
    before = lit(opened)
    opened.driver.execute_script(slide, "size", 4)
    opened.until(lambda: lit(opened) > before)
    opened.driver.execute_script(slide, "budget", 0.1)
    assert opened.text("budget-words") == "0.1 million"
    assert opened.complaints() == []


def test_a_new_legend_has_no_old_colours_and_asks_for_nothing_that_is_not_there(opened):
    colour_by(opened, "deviation")
    opened.until(lambda: opened.text("message").startswith("Measure the flatness of a place first"))
    # Colours that do not come.
    opened.driver.execute_script(
        """const fetched = window.fetch, never = new Promise(() => {});
           window.fetch = (path, ...more) => String(path).startsWith("colours/") ? never : fetched(path, ...more);"""
    )
    colour_by(opened, "sigma")
    opened.until(lambda: opened.text("scale-words").endswith(" mm"))
    settle(opened)
    seen = picture(opened, "cloud").astype(int)
    grey = np.ptp(seen[seen[..., 1] > 40][:, :3], axis=1)
    assert len(grey) and grey.max() == 0
    assert opened.complaints() == []


def test_the_room_by_the_keyboard_and_over_a_reload(opened):
    opened.at("room").send_keys("\ue007")
    # Of both clouds.
    opened.until(lambda: opened.text("measured").count("height") == 2)
    opened.driver.refresh()
    opened.until(lambda: opened.text("measured").count("height") == 2)
    # The focus may stay on a button, whose own key is Enter.
    for _ in range(6):
        opened.at("undo").send_keys("u")
    opened.until(lambda: listed(opened) == [])
    opened.at("room").send_keys("f")
    opened.until(lambda: opened.text("message").startswith("Click a flat place"))
    assert opened.at("flatness").get_attribute("aria-pressed") == "true"
    # A cross where Enter measures, in no canvas: one over the cloud halves the pictures a second.
    opened.at("cloud").send_keys("p")
    opened.until(lambda: not opened.driver.execute_script("return document.getElementById('cross').hidden"))
    free = opened.driver.execute_script("return document.getElementById('panel').getBoundingClientRect().left")
    where = "const at = document.getElementById('cross').getBoundingClientRect(); return [at.x, at.y]"
    place = opened.driver.execute_script(where)
    assert place == pytest.approx([free / 2, WIDE[1] / 2], abs=1) and opened.colours("marks") == 1

    def middle():
        seen = np.nonzero(picture(opened, "cloud")[..., 1] > 40)[1]
        return seen.mean() if len(seen) else np.inf

    settle(opened)
    assert opened.too_wide() <= 0
    before = middle()
    # Moving to the right takes the cloud to the left.
    opened.at("cloud").send_keys("\ue008" + 2 * "\ue014")
    opened.until(lambda: middle() < before - 80)


def test_a_telephone(looks, url):
    looks.open(url, NARROW)
    looks.until(lambda: looks.colours("cloud") > 20)
    assert looks.too_wide() <= 0
    top = "return document.getElementById('panel').getBoundingClientRect().top"
    above = looks.driver.execute_script(top)
    assert above > 0.5 * NARROW[1]
    # The room is in the part of the picture that the panel leaves free, and fills it from side to side.
    looks.until(lambda: np.ptp(np.nonzero(picture(looks, "cloud")[..., 1] > 40)[1]) > 0.6 * NARROW[0])
    row, column = np.nonzero(picture(looks, "cloud")[..., 1] > 40)
    assert np.percentile(row, 99) < above and 0 < column.min() and column.max() < NARROW[0] - 1
    # Nothing is wider than the page, whatever is open, chosen or long.
    looks.driver.execute_script(
        """for (const one of document.querySelectorAll("[hidden]")) if (one.closest("#panel")) one.hidden = false;
           for (const one of document.querySelectorAll("details")) one.open = true;
           for (const one of ["message", "scale-words", "caption"])
             document.getElementById(one).textContent = "a".repeat(99);"""
    )
    across = "return [document.documentElement, document.getElementById('panel')].map((one) => one.scrollWidth)"
    assert max(looks.driver.execute_script(across)) <= NARROW[0]
    looks.open(url, NARROW)
    looks.until(lambda: looks.colours("cloud") > 20)
    looks.click("fold")
    assert looks.driver.execute_script(top) > 0.85 * NARROW[1] and looks.text("message") == "Click a point."


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
    # A guest, as a browser is one.
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    opener.open(url).close()
    url = url.partition("?")[0]

    def status(path):
        try:
            with opener.open(url.rstrip("/") + path) as answer:
                return answer.status
        except urllib.error.HTTPError as refused:
            with refused:
                return refused.code

    assert status("/points/0/0") == 200 and status("/colours/1/0?by=sigma") == 200
    for path in ("/points/9/0", "/points/0/999999", "/points/0/x", "/colours/0/0?by=all", "/colours/0/0", "/../x"):
        assert status(path) == 404, path
    for plane in ("0", "-1", "x", ""):
        assert status(f"/scale?by=deviation&page=nobody&plane={plane}") == 404
    with opener.open(url + "scene") as answer:
        scene = json.loads(answer.read())
    assert [cloud["name"] for cloud in scene["clouds"]][1] == "<b>grey"


def test_the_browser_is_opened_without_the_token_among_the_words_of_its_call(looks, room, monkeypatch):
    called = []
    monkeypatch.setattr("webbrowser.open_new_tab", called.append)
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room]):
        with in_browser(address.url(with_token=True)):
            (place,) = called
            assert address.token not in place
            file = Path(urllib.request.url2pathname(place.removeprefix("file://")))
            assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)
            looks.open(place)
            looks.until(lambda: looks.driver.current_url == address.url() and looks.colours("cloud") > 20)
        assert not file.parent.exists()
        looks.driver.refresh()
        looks.until(lambda: looks.colours("cloud") > 20)


def test_the_products_of_a_project_are_listed_as_they_are_now(looks, room):
    rows = [("cloud/one", "done", ""), ("mesh/one", "stale", "settings changed")]
    rows += [("cloud/two", "failed", "no <b>laser</b>")]
    address = open_address("127.0.0.1", 0, option="--web-port")
    with serve_clouds(address, [room], products=lambda: rows):
        looks.open(address.url(with_token=True))
        looks.until(lambda: looks.at("products-part").is_displayed())
        looks.driver.execute_script("document.getElementById('products-part').open = true")
        looks.until(lambda: looks.text("products-words") == "1 done, 1 stale, 1 failed")
        listed = "failed cloud/two\nno <b>laser</b>\nstale mesh/one\nsettings changed\ndone cloud/one"
        assert looks.text("products") == listed
        rows[:] = [("cloud/one", "done", "")]
        looks.click("look-again")
        looks.until(lambda: looks.text("products-words") == "1 done")
