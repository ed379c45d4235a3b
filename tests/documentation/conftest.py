"""The browser in which pages of the site are opened."""

from ..browser.driver import browser as browser
