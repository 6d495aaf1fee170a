"""Pages in a headless Chromium, driven by Selenium; nothing is loaded from a network."""

import contextlib
from pathlib import Path

import pytest

from benchmarks.browser import chromium, found

PATHS = found()
needs_chromium = pytest.mark.skipif(PATHS is None, reason="needs chromium and chromedriver on the PATH")


@contextlib.contextmanager
def opened(profile: Path, *, scripts: bool = True, calm: bool = False):
    """A browser with a fresh profile, 1,200 pixels wide.

    Args:
        profile: an empty folder.
        scripts: whether pages may run any.
        calm: whether the reader wants little motion.
    """
    assert PATHS is not None
    more = ["--force-device-scale-factor=1", *(["--force-prefers-reduced-motion"] if calm else [])]
    with chromium(PATHS, profile, height=1000, more=more) as browser:
        if not scripts:
            browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
        yield browser
