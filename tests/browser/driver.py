"""A real browser without a window, and what tests ask of a page in it."""

import importlib.util
import os
import shutil

import pytest


WIDE, NARROW = (1400, 1000), (390, 844)
"""Sizes of windows [px]: of a desk and of a telephone."""
PATIENCE_S = 30
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def missing_for_the_browser():
    """What a browser needs and is not there, as one line; "" if nothing is missing."""
    programs = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    if programs:
        return f"pages need {' and '.join(programs)}: type `make browser-deps`"
    return "" if importlib.util.find_spec("selenium") else "pages need selenium"


@pytest.fixture(scope="module")
def browser():
    """A browser; without the programs its tests are skipped, with JAXSCAN_REQUIRE_BROWSER=1 that is an error."""
    if reason := missing_for_the_browser():
        if os.environ.get("JAXSCAN_REQUIRE_BROWSER"):
            raise pytest.UsageError(f"JAXSCAN_REQUIRE_BROWSER is set, but {reason}")
        pytest.skip(reason)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    for flag in _FLAGS:
        options.add_argument(flag)
    options.binary_location = shutil.which("chromium")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    driver.set_script_timeout(PATIENCE_S)
    yield driver
    driver.quit()


class Looks:
    """A person at a page."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, url, size=WIDE):
        """Opens an address in a window of this size."""
        # Windows are not narrower than 500 px; what a page sees may be.
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 500},
        )
        self.driver.get_log("browser")
        self.driver.get(url)

    def at(self, name):
        """The element with this id."""
        from selenium.webdriver.common.by import By

        return self.driver.find_element(By.ID, name)

    def text(self, name):
        """What the element with this id says."""
        return self.at(name).text

    def click(self, name):
        """Clicks the element with this id, as soon as it may be clicked."""
        self.until(lambda: self.at(name).is_enabled())
        self.at(name).click()

    def until(self, holds):
        """Waits until `holds()`, and returns what it gave."""
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.driver, PATIENCE_S, 0.05).until(lambda _: holds())

    def too_wide(self):
        """How much wider than the window the page is [px]: it scrolls sideways where this is more than 0."""
        return self.driver.execute_script(
            "const page = document.documentElement; return page.scrollWidth - page.clientWidth"
        )

    def colours(self, name):
        """How many different colours the canvas with this id has."""
        script = """
          const from = document.getElementById(arguments[0]), copy = document.createElement("canvas");
          copy.width = from.width; copy.height = from.height;
          const pen = copy.getContext("2d");
          pen.drawImage(from, 0, 0);
          const data = new Uint32Array(pen.getImageData(0, 0, copy.width, copy.height).data.buffer);
          return new Set(data).size;"""
        return self.driver.execute_script(script, name)

    def complaints(self):
        """What the browser complained about since the page was opened."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
