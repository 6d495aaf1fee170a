"""Pages in a headless Chromium, driven by Selenium; nothing is loaded from a network."""

import contextlib
import shutil
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--force-device-scale-factor=1",
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None, reason="needs chromium and chromedriver on the PATH"
)


@contextlib.contextmanager
def opened(profile: Path, *, scripts: bool = True, calm: bool = False):
    """A browser with a fresh profile, 1,200 pixels wide.

    Args:
        profile: an empty folder.
        scripts: whether pages may run any.
        calm: whether the reader wants little motion.
    """
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for option in (*QUIET, f"--user-data-dir={profile}", "--window-size=1200,1000"):
        options.add_argument(option)
    if calm:
        options.add_argument("--force-prefers-reduced-motion")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = Service(DRIVER)
    browser = webdriver.Chrome(options=options, service=service)
    try:
        if not scripts:
            browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
        yield browser
    finally:
        browser.quit()
