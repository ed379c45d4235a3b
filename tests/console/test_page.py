"""The console's page in a real browser, on a rig on paper."""

import asyncio
import json
import time

import numpy as np
import pytest

from jaxscan.files.capture import open_capture

from ..browser.driver import NARROW, Looks


ESCAPE, LEFT = "\ue00c", "\ue012"
"""Keys, as WebDriver names them."""
TILT = {"tilt_deg": 0, "towards_deg": 0}
CAPTURE = {
    "name": "room",
    "kind": "sweep",
    "records": 0,
    "complete": True,
    "problem": "",
    "changed": 0.0,
    "cloud": False,
}


@pytest.fixture
def visit(console, browser):
    """`visit(work)` calls `work(looks, url)` in another thread while the console runs."""

    def call(work):
        url = console.address.url(with_token=True)

        async def pages(console):
            await asyncio.to_thread(work, Looks(browser), url)
            await asyncio.to_thread(browser.get, "about:blank")

        console.run(pages)

    return call


def test_a_scan_by_clicks(visit, console):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        looks.at("sweep-name").clear()
        looks.at("sweep-name").send_keys("kitchen")
        looks.click("sweep")
        looks.until(lambda: "complete, 10 records" in looks.text("ended"))
        assert looks.text("count") == "kitchen: 10 of 10 records" and looks.text("laser") == "laser off"
        looks.until(lambda: looks.colours("picture") > 20)
        assert "of 255" in looks.text("peak-dn")
        looks.until(
            lambda: looks.driver.execute_script("return document.querySelector('#captures img')?.naturalWidth > 0")
        )
        looks.driver.execute_script("[...document.querySelectorAll('#captures button')][0].click()")
        looks.until(lambda: looks.driver.execute_script("return document.getElementById('record').naturalWidth > 0"))
        assert looks.text("record-name") == "kitchen, 1 of 10"
        assert looks.driver.execute_script("return document.getElementById('progress').position") == 1
        slide(looks, "records", 3)
        assert looks.text("record-name") == "kitchen, 4 of 10"
        shown = lambda: looks.at("record").get_attribute("src").partition("/pictures/")[2]
        assert shown() == "kitchen/3?lit=1"
        looks.click("lit")
        assert shown() == "kitchen/3"
        looks.click("close")
        looks.until(lambda: not looks.at("opened").is_displayed())
        # A taken name is not offered again; nor is anything to be resumed.
        assert looks.at("sweep-name").get_attribute("value") == "kitchen-2"
        assert looks.text("next").startswith("First Look") and not looks.at("resume").is_enabled()
        assert looks.complaints() == []

    visit(work)
    assert len(open_capture(console.captures.path("kitchen"))) == 10


def test_stop_by_a_key_and_resume_by_a_click_over_a_reload(visit, console, paper, held):
    waits, _ = held(4)

    def work(looks, url):
        looks.open(url)
        looks.click("sweep")
        assert waits.wait(60)
        looks.driver.refresh()
        looks.until(lambda: looks.text("doing") == "scanning" and looks.at("pause").is_enabled())
        paper.table.laser = True
        looks.at("stop").send_keys(ESCAPE)
        looks.until(lambda: looks.text("ended") == "Stopped: the laser is off.")
        assert not paper.table.laser and not paper.table.contactor
        assert looks.text("next") == "Resume goes on with room."
        looks.driver.refresh()
        looks.click("resume")
        looks.until(lambda: "complete, 10 records" in looks.text("ended"))

    visit(work)
    assert len(open_capture(console.captures.path("room"))) == 10


def test_what_goes_on_is_said_and_what_may_be_compared(visit, console):
    one, other = (CAPTURE | {"name": name} for name in ("one", "other"))

    def work(looks, url):
        buttons = "return Array.from(document.querySelectorAll('#captures button'), (one) => one.textContent)"
        offered = lambda: [text for text in looks.driver.execute_script(buttons) if "ompare" in text]
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        work = {"what": "calibrate boards", "running": True, "well": None, "lines": [], "result": {}}
        console.slate.write(works=[work])
        looks.until(lambda: looks.text("next") == "The calibration is calculated: wait for its verdict.")
        console.slate.write(works=[], captures=[one | {"cloud": True}, other])
        looks.until(lambda: looks.text("next").startswith("one has its cloud"))
        assert offered() == []
        console.slate.write(captures=[each | {"cloud": True} for each in (one, other)])
        looks.until(lambda: offered() == ["Compare …", "Compare …"])
        press(looks, "Compare …")
        looks.until(lambda: offered() == ["Do not compare", "Compare with one"])
        press(looks, "Do not compare")
        looks.until(lambda: offered() == ["Compare …", "Compare …"])
        console.slate.write(laser="unknown")
        looks.until(lambda: "switch its supply off" in looks.text("laser"))

    visit(work)


def test_the_board_and_its_button_are_seen_together_on_a_telephone(visit, console):
    def work(looks, url):
        looks.open(url, NARROW)
        looks.until(lambda: looks.text("doing") == "ready")
        sides = {
            "covered": [[False] * 4] * 3,
            "corners": [[0] * 4] * 3,
            "depth_m": None,
            "found": [],
            "problem": "no board",
        }
        guide = {"pose": None, "advice": ["come nearer"], "min_tilt_deg": 20, **sides}
        guide["next"] = {"at": [0.5, 0.5], "tilt_deg": 0, "towards_deg": 0}
        placing = {"kind": "free", "number": 0, "total": 3, "at_deg": None}
        console.slate.write(doing="placing", placing=placing, guide=guide, planned=3, done=0, left_s=None)
        looks.until(lambda: looks.at("take").is_displayed())
        middle = "return [...arguments].map((id) => document.getElementById(id).getBoundingClientRect().top)"
        picture, button = looks.driver.execute_script(middle, "picture", "take")
        assert 0 < picture < button < NARROW[1] - 120
        assert looks.text("left") == "" and looks.complaints() == []

    visit(work)


def slide(looks, name, value):
    """Moves a slider, or types into a field, and lets it go."""
    script = """const one = document.getElementById(arguments[0]);
        one.value = arguments[1];
        for (const kind of ["input", "change"]) one.dispatchEvent(new Event(kind));"""
    looks.driver.execute_script(script, name, value)


def test_the_answers_of_a_person_and_what_a_lost_page_does(visit, console):
    answers = []
    console.desk.answer = answers.append

    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        looks.click("lost-stops")
        looks.until(lambda: console.slate.read("lost") == "stop")
        looks.click("lost-stops")
        looks.until(lambda: console.slate.read("lost") == "go on")
        console.slate.write(doing="placing", placing={"kind": "free", "number": 0, "total": 3, "at_deg": None})
        pose = {
            "covered": [[False]],
            "corners": [[0]],
            "depth_m": None,
            "found": [],
            "problem": "no board",
            "pose": None,
        }
        console.slate.write(guide=pose | {"advice": [], "min_tilt_deg": 20, "next": {"at": [0.5, 0.5]} | TILT})
        for name in ("take", "enough", "enough-of-all"):
            looks.until(lambda name=name: looks.at(name).is_displayed())
            looks.click(name)
        looks.driver.execute_script("document.activeElement.blur()")
        looks.driver.find_element("tag name", "body").send_keys(" ")
        looks.until(lambda: len(answers) == 4)
        console.slate.write(doing="nothing", placing=None, has_board=True)
        looks.until(lambda: looks.at("boards").is_enabled())
        looks.at("boards-name").clear()
        looks.at("boards-name").send_keys("hall\ue007")
        # The name has arrived; this rig has no board all the same.
        looks.until(
            lambda: "has no [board] table" in looks.text("lines") and "board hall begins" in looks.text("lines")
        )

    visit(work)
    assert answers == ["take", "enough", "enough of all", "take"]


def green(looks):
    """The buttons that are the next step."""
    script = """return Array.from(document.querySelectorAll("button.go"), (one) => one.textContent)"""
    return looks.driver.execute_script(script)


def press(looks, text, within="captures"):
    """Presses the button with these words."""
    script = """[...document.getElementById(arguments[1]).querySelectorAll("button")]
        .find((one) => one.textContent === arguments[0]).click()"""
    looks.driver.execute_script(script, text, within)


def test_one_green_button_is_the_next_step_and_the_rig_is_set_by_hand(visit, console, paper):
    paper.controller.trigger = lambda ms=None: paper.camera.expose(paper.table.position, paper.table.shines)

    def work(looks, url):
        looks.open(url, (1400, 900))
        looks.until(lambda: green(looks) == ["Look"])
        # Camera and cloud fill the desk, and captures are in sight.
        boxes = looks.driver.execute_script(
            """return ["picture", "cloud", "captures"].map((id) => {
                 const box = document.getElementById(id).getBoundingClientRect();
                 return [box.width, box.height, box.bottom];
               })"""
        )
        assert min(boxes[0][0], boxes[1][0]) > 400 and min(boxes[0][1], boxes[1][1]) > 380 and boxes[2][2] <= 900
        assert looks.too_wide() <= 0
        before = boxes[0][0]
        looks.driver.execute_script("document.querySelector('.camera .enlarge').click()")
        assert looks.at("picture").size["width"] > 1.8 * before and not looks.at("cloud").is_displayed()
        looks.driver.execute_script("document.querySelector('.camera .enlarge').click()")
        looks.click("aim")
        looks.until(lambda: "of 255" in looks.text("peak-dn") and looks.colours("histogram") > 1)
        press(looks, "+10°", "jog")
        looks.until(lambda: looks.text("angle") == "table at 10.00°")
        press(looks, "−1°", "jog")
        looks.until(lambda: looks.text("angle") == "table at 9.00°")
        press(looks, "home", "jog")
        looks.until(lambda: looks.text("angle") == "table at 0.00°")
        looks.click("light")
        looks.until(lambda: looks.text("peak-dn") == "–")
        assert not paper.table.contactor
        looks.click("light")
        looks.until(lambda: "of 255" in looks.text("peak-dn"))
        looks.at("exposure-ms").clear()
        looks.at("exposure-ms").send_keys("20\ue007")
        looks.until(lambda: "camera.exposure_ms = 20" in looks.text("exposure"))
        # A field is not written anew under a person's hands.
        looks.driver.execute_script("document.activeElement.blur()")
        slide(looks, "exposure-log", 0.5)
        looks.until(lambda: "camera.exposure_ms = 3.2 into" in looks.text("exposure"))
        slide(looks, "gain-db", 6)
        looks.until(lambda: "camera.exposure_ms = 3.2 and camera.gain_db = 6 into" in looks.text("exposure"))
        looks.click("auto")
        looks.until(lambda: "Auto: " in looks.text("lines"))
        looks.click("stop")
        looks.until(lambda: looks.text("doing") == "ready")
        assert not paper.table.contactor and looks.complaints() == []

    visit(work)


def test_a_verdict_has_the_colour_of_the_users_own_goal(visit, console):
    verdict = {"kind": "plain", "headline": "Good to 2.4 mm for a 4 m wall from 2.5 m", "explanation": ""}
    lengths = [
        {"what": "4 m wall from 2.5 m", "sigma_mm": 2.4},
        {"what": "of that from the angles of the table", "sigma_mm": 2.39, "part": True},
        {"what": "300 mm along the stripe at 2.5 m", "sigma_mm": 0.0131},
    ]
    about = {"capture": "boards", "well": True, "verdict": verdict, "sigma_mm": 2.4, "lengths": lengths}

    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        kind = lambda: looks.at("headline").get_attribute("class").split()[1:]
        for goal, colour, said in ((None, [], "Write goal_mm"), (3.0, ["good"], ": met"), (1.0, ["open"], ": not met")):
            console.slate.write(verdict=about, goal_mm=goal)
            looks.until(lambda said=said: said in looks.text("goal"))
            assert kind() == colour
        said = looks.text("lengths").splitlines()
        assert said[:2] == ["± 2.4 mm 4 m wall from 2.5 m", "± 2.4 mm of that from the angles of the table"]
        assert said[2].startswith("± 0.013 mm ")
        shown = "return Array.from(document.querySelectorAll('#lengths tr'), (row) => row.className)"
        assert looks.driver.execute_script(shown) == ["", "part", ""]
        calibrations = [{"file": "better.json", "beside": True, "good": True, "headline": "Good to 0.9 mm"}]
        calibrations[0] |= {"sigma_mm": 0.9, "changed": time.time() - 7300}
        console.slate.write(calibration="better.json", calibrations=calibrations, verdict=None)
        looks.until(lambda: looks.text("calibration") == "Good to 0.9 mm; 2 hours ago")
        assert looks.at("calibration").get_attribute("class") == "good"
        assert looks.at("calibrations").get_attribute("value") == "better.json" and green(looks) == ["Scan"]

    visit(work)


def test_a_cloud_of_another_calibration_is_to_be_made_again(visit, console):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        made = CAPTURE | {"cloud": True, "made": [], "made_with": "sha256:a"}
        console.slate.write(calibration="better.json", calibration_digest="sha256:b", captures=[made])
        looks.until(lambda: looks.text("next").startswith("Reconstruct room again"))
        assert green(looks) == ["Reconstruct"] and "its cloud is of another calibration" in looks.text("captures")
        console.slate.write(calibration_digest="sha256:a")
        looks.until(lambda: green(looks) == ["Look around"])
        assert "another calibration" not in looks.text("captures")

    visit(work)


def test_a_second_calibration_that_is_worse_is_said_and_the_better_one_is_offered(visit, console):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        known = [
            {
                "file": file,
                "beside": False,
                "good": True,
                "headline": f"Good to {mm} mm",
                "sigma_mm": mm,
                "digest": digest,
            }
            | {"changed": time.time() - age}
            for file, mm, digest, age in (("boards-2.json", 1.9, "sha256:b", 0), ("room.json", 0.24, "sha256:a", 7300))
        ]
        made = CAPTURE | {"cloud": True, "made": [], "made_with": "sha256:a"}
        used = {"calibration": "captures/boards-2.json", "calibration_digest": "sha256:b"}
        console.slate.write(captures=[made], calibrations=known, **used)
        looks.until(lambda: "room.json, with which room was made, is good to 0.24 mm" in looks.text("next"))
        assert looks.text("next").startswith("boards-2.json is used now: 1.9 mm.") and green(looks) == ["Scan"]
        assert "its cloud is of room.json" in looks.text("captures")
        listed = "return Array.from(document.querySelectorAll('#calibrations option'), (one) => one.textContent)"
        offered = looks.driver.execute_script(listed)
        assert offered == ["1.9 mm, boards-2.json, just now", "0.24 mm, room.json, 2 hours ago"]
        # The better one is the newer one: the cloud is to be made again.
        console.slate.write(calibrations=[known[0] | {"sigma_mm": 0.1}, known[1]])
        looks.until(lambda: green(looks) == ["Reconstruct"])
        # Chosen on the page, by a person.
        for option in looks.at("calibrations").find_elements("tag name", "option"):
            if "room.json" in option.text:
                option.click()
        looks.until(lambda: "room.json: is no calibration of this rig" in looks.text("problem"))

    visit(work)


def test_how_long_a_calculation_takes_is_said_where_it_is_waited_for(visit, console):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        begun = {"what": "calibrate boards, the poses so far", "running": True, "well": None, "result": {}}
        console.slate.write(works=[begun | {"lines": ["a note", "Calibrating: 20 %, about 50 s left"]}])
        looks.until(lambda: looks.text("next").endswith("wait for its verdict. about 50 s left"))
        verdict = {"kind": "plain", "headline": "Good to 2.4 mm", "explanation": ""}
        console.slate.write(works=[], verdict={"well": True, "so_far": "boards-2", "verdict": verdict})
        looks.until(lambda: looks.text("headline") == "boards-2 so far: Good to 2.4 mm")

    visit(work)


def test_what_is_made_of_a_capture_and_that_it_is_deleted_only_when_asked_twice(visit, console, monkeypatch):
    begun = []
    monkeypatch.setattr("jaxscan.cli.console.works.Works.begin", lambda works, work: begun.append(work.words))
    monkeypatch.setattr("jaxscan.cli.console.works.Works._before", lambda works, name: works.calibration)
    (console.captures.folder / "room").mkdir(parents=True)
    (console.captures.folder / "room" / "capture.toml").write_text("")
    console.calibration = console.captures.folder / "boards.json"
    capture = CAPTURE | {"records": 1}

    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        console.slate.write(calibration="boards.json", captures=[capture | {"cloud": False, "made": []}])
        looks.until(lambda: green(looks) == ["Reconstruct"])
        assert "1 record" in looks.text("captures") and "1 records" not in looks.text("captures")
        console.slate.write(captures=[capture | {"cloud": True, "made": ["plan"]}])
        looks.until(lambda: green(looks) == ["Look around"])
        for text in ("Recalibrate", "Mesh", "Report", "Reconstruct"):
            press(looks, text)
        looks.until(lambda: len(begun) == 4)
        link = looks.driver.execute_script("return document.querySelector('#captures a.made').getAttribute('href')")
        assert link == "/made/room/plan"
        press(looks, "Delete …")
        press(looks, "Keep it")
        press(looks, "Rename …")
        looks.driver.execute_script("document.querySelector('#captures input').value = 'hall'")
        press(looks, "Rename")
        looks.until(lambda: (console.captures.folder / "hall").is_dir())
        looks.until(lambda: "hall" in looks.text("captures"))
        press(looks, "Delete …")
        press(looks, "Delete for good")
        looks.until(lambda: not (console.captures.folder / "hall").exists())
        looks.until(lambda: "nothing captured yet" in looks.text("captures"))
        # The capture on the page has no pictures on the disk.
        assert [line for line in looks.complaints() if "/pictures/" not in line] == []

    visit(work)
    assert [words[0] for words in begun] == ["recalibrate", "mesh", "report", "reconstruct"]


def test_two_windows(visit):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        first = looks.driver.current_window_handle
        looks.driver.switch_to.new_window("window")
        looks.open(url)
        looks.until(lambda: looks.text("role") == "watching")
        assert not looks.at("sweep").is_enabled() and looks.at("stop").is_enabled()
        looks.click("take-over")
        looks.until(lambda: looks.text("role") == "you operate, 1 watching" and looks.at("sweep").is_enabled())
        looks.driver.close()
        looks.driver.switch_to.window(first)
        assert looks.text("role") == "watching"

    visit(work)


def test_on_a_telephone_nothing_is_cut_off_and_stop_is_at_hand(visit, console):
    def work(looks, url):
        looks.open(url, NARROW)
        looks.until(lambda: looks.text("doing") == "ready")
        wide = (
            "return [document.documentElement.scrollWidth, innerWidth, document.querySelector('header').clientHeight]"
        )
        long = "a" * 64
        states = (
            {},
            {"doing": "aim", "live": {"width": 128, "height": 96, "stripe": [], "peak_dn": 255, "clipped": 0.9}},
            {"doing": "boards", "laser": "may shine", "capture": long, "planned": 50, "done": 9, "left_s": 99},
            {"doing": "sweep", "silence": "The rig has not answered for 7 s.", "estop": True},
            {"doing": "nothing", "laser": "off", "silence": "", "estop": False, "captures": [CAPTURE | {"name": long}]},
            {"works": [{"what": f"mesh {long}", "running": True, "well": None, "lines": [long * 3], "result": {}}]},
            {"ended": f"{long}/{long}: complete.", "problem": f"{long}{long}", "calibration": f"{long}.json"},
            {"calibrations": [{"file": f"{long}.json", "good": True, "headline": long, "sigma_mm": 1, "changed": 0}]},
        )
        for state in states:
            console.slate.write(**state)
            time.sleep(0.3)
            *widths, head = looks.driver.execute_script(wide)
            assert widths == [390, 390], state
            # Stop is in one line with what the rig does, but for long news of it.
            assert head < 70 or "silence" in state, state
        looks.driver.execute_script("scrollTo(0, document.body.scrollHeight)")
        box = looks.driver.execute_script(
            "const b = document.getElementById('stop').getBoundingClientRect(); return [b.top, b.bottom, b.height]"
        )
        assert 0 <= box[0] and box[1] <= 844 and box[2] >= 44
        # It covers no words: it is in the head of the page, wherever one reads.
        scroll = "scrollTo(0, arguments[0]); return document.getElementById('stop').getBoundingClientRect().bottom"
        for top in (0, 300, 600):
            bottom = looks.driver.execute_script(scroll, top)
            head = looks.driver.execute_script("return document.querySelector('header').getBoundingClientRect().bottom")
            assert bottom <= head < 120

    visit(work)


def test_points_are_drawn_as_they_come(visit, console):
    def work(looks, url):
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        assert looks.colours("cloud") == 1
        generator = np.random.default_rng(2)
        console.slate.clear_cloud(2000)
        for _ in range(2):
            xyz, rgb = generator.normal(size=(1000, 3)), generator.integers(0, 256, (1000, 3))
            console.slate.grow(xyz.astype(np.float32), rgb.astype(np.uint8))
        looks.until(lambda: looks.text("points") == "2,000 points shown")
        looks.until(lambda: looks.colours("cloud") > 100)
        # All of a room without strays is in the picture, and fills it.
        console.slate.clear_cloud(2000)
        xyz = np.stack(np.meshgrid([-2.6, 2.6], [-2.2, 2.2], [-1.2, 1.4]), -1).reshape(-1, 3).repeat(125, 0)
        console.slate.grow(xyz.astype(np.float32), np.full((1000, 3), 255, np.uint8))
        looks.until(lambda: looks.text("points") == "1,000 points shown")
        edges = """
          const from = document.getElementById("cloud"), copy = document.createElement("canvas");
          copy.width = from.width; copy.height = from.height;
          const pen = copy.getContext("2d"), seen = [];
          pen.drawImage(from, 0, 0);
          pen.getImageData(0, 0, copy.width, copy.height).data.forEach((level, k) => {
            if (k % 4 === 0 && level > 128) seen.push((k / 4) % copy.width, Math.floor(k / 4 / copy.width));
          });
          const of = (first, size) => {
            const all = seen.filter((_, k) => k % 2 === first);
            return [Math.min(...all) / size, Math.max(...all) / size];
          };
          return [...of(0, copy.width), ...of(1, copy.height)];"""
        looks.until(lambda: looks.driver.execute_script(edges)[0] is not None)
        left, right, top, bottom = looks.driver.execute_script(edges)
        assert 0.01 < min(left, top, 1 - right, 1 - bottom) < 0.1
        looks.at("cloud").send_keys("+", LEFT)
        assert looks.complaints() == []
        # A page that comes later gets all of them.
        looks.driver.refresh()
        looks.until(lambda: looks.text("points") == "1,000 points shown")

    visit(work)


def test_another_site_opens_no_socket(visit, console):
    def work(looks, url):
        # A guest's browser, with its cookie.
        looks.open(url)
        looks.until(lambda: looks.text("doing") == "ready")
        url = console.address.url()
        looks.open("data:text/html,<p>a page of a stranger</p>")
        script = """
          const [url, done] = arguments, socket = new WebSocket(url);
          socket.onopen = () => done("open");
          socket.onerror = () => done("refused");"""
        assert looks.driver.execute_async_script(script, url.replace("http", "ws") + "socket") == "refused"
        # Nor a page in a frame of theirs, nor its picture.
        looks.open(f"data:text/html,<iframe src='{url}'></iframe><img src='{url}icon.svg'>")
        looks.until(lambda: looks.driver.execute_script("return document.images[0].complete"))
        assert looks.driver.execute_script("return document.images[0].naturalWidth") == 0

    visit(work)
    assert console.slate.read("doing") == "nothing"


def test_words_of_strangers_are_shown_as_words(visit, console):
    folder = console.captures.folder / "evil"
    folder.mkdir(parents=True)
    (folder / "capture.toml").write_text('format = "jaxscan-capture/1"\nkind = "<img src=x onerror=alert(1)>"\n')

    def work(looks, url):
        looks.open(url)
        looks.until(lambda: "evil" in looks.text("captures"))
        assert "<img src=x" in looks.text("captures")
        assert looks.driver.execute_script("return document.querySelectorAll('#captures img').length") == 0
        assert json.dumps(looks.complaints()) == "[]"

    visit(work)
