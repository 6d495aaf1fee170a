"""A headless Chromium of this machine, for pages; nothing is downloaded."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

BROWSERS, DRIVERS = (
    ("chromium", "chromium-browser", "google-chrome"),
    ("chromedriver", "chromium.chromedriver"),
)
# Without a sandbox, which root cannot have, and without anything that would call home.
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--disable-dev-shm-usage",
)


def found() -> tuple[str, str] | None:
    """Paths of a browser and of its driver; None if this machine has not both."""
    browser, driver = (next(filter(None, map(shutil.which, names)), None) for names in (BROWSERS, DRIVERS))
    return None if browser is None or driver is None else (browser, driver)


@contextlib.contextmanager
def chromium(
    paths: tuple[str, str],
    profile: Path,
    width: int = 1200,
    height: int = 1400,
    more: Sequence[str] = (),
) -> Iterator[Chrome]:
    """A browser with a fresh profile in a folder.

    Args:
        paths: of browser and driver.
        profile: the folder.
        width, height: of the window [px].
        more: further arguments of the browser.
    """
    options = ChromeOptions()
    options.binary_location = paths[0]
    for argument in (*ARGUMENTS, *more, f"--window-size={width},{height}", f"--user-data-dir={profile}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = Chrome(options=options, service=Service(paths[1]))
    chrome.set_script_timeout(60)
    try:
        yield chrome
    finally:
        chrome.quit()
