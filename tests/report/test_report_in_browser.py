"""Reports in a browser: charts that zoom, the sample under the mouse, the history played, print."""

import base64
import time

import numpy as np
import pytest

from gtr_jax.plots.style import figure, styled
from gtr_jax.report.page import Figure, Report, render
from gtr_jax.report.scene import in_space
from tests.browser import needs_chromium, opened
from tests.histories import SETTINGS, made_up
from tests.plots.test_spatial_pictures import BODY
from tests.plots.test_spatial_pictures import made_up as bent

pytestmark = needs_chromium
K = 121


def in_plane():
    """A body of two steps' shapes, bent by up to a radian, at three of the samples."""
    at = np.linspace(0.0, 1.0, 30)

    def step(turn):
        angle = turn * at
        x, y = (np.concatenate([[0], np.cumsum(f(angle[1:]))]) / 29 for f in (np.cos, np.sin))
        return {
            "place": np.round(20_000 * np.stack([x, y], axis=1)).astype(int).ravel().tolist(),
            "angle": np.round(1e4 * angle).astype(int).tolist(),
            "tension": [np.round(1000 * turn * np.ones(30)).astype(int).tolist()],
            "markers": [],
        }

    shape = {"space": False, "scale": 0.01, "most": 40.0, "radius": [8.0] * 30, "offsets": [[5.0] * 30]}
    return {**shape, "ends": [30], "samples": [0, 40, K - 1], "steps": [step(t) for t in (0.0, 1.0, 0.2)]}


@styled
def picture():
    fig, (axes,) = figure(2.0)
    axes.plot([0, 1])
    return fig


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    postures = [bent(f"step {k}", k / 4) for k in range(5)]
    space = {"space": True, "samples": [0, 30, 60, 90, K - 1], **in_space(BODY, postures)}
    report = Report(
        title="Made up",
        verdict="All of it is made up.",
        figures=[Figure("loop", picture(), "The loop."), Figure("other", picture(), "Another.")],
        playbacks=[
            made_up(K, first=40, body=in_plane(), stills=["loop"]),
            made_up(K, body=space, title="Space"),
        ],
    )
    (folder / "report.html").write_text(render(report, SETTINGS, "[robot]"), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    with opened(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture
def shown(browser, page):
    """The page, opened anew; afterwards nothing must have gone wrong in it."""
    browser.get((page / "report.html").as_uri())
    yield browser
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def all_of(browser, what):
    return browser.find_elements("css selector", what)


def told(browser, which=0):
    return all_of(browser, ".playback output")[which].text


def range_of(canvas):
    return [float(v) for axis in "xy" for v in (canvas.get_attribute(f"data-{axis}") or "").split()]


def in_the_middle(canvas):
    """The sample in the middle of a chart over time, from its range and the room beside its axes."""
    low, high = range_of(canvas)[:2]
    wide = canvas.size["width"]
    seconds = low + (wide / 2 - 56) / (wide - 56 - 18) * (high - low)
    return 1 + seconds * (K - 1) / 60


def inked(browser, canvas):
    """How many points of a canvas are drawn on."""
    return browser.execute_script(
        "const c = arguments[0], d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n;",
        canvas,
    )


def actions(browser):
    from selenium.webdriver.common.action_chains import ActionChains

    return ActionChains(browser, duration=0)


def keys():
    from selenium.webdriver.common.keys import Keys

    return Keys


def test_charts_stand_in_for_their_pictures_and_bring_them_back(shown):
    assert told(shown).startswith("sample 41 of 121, time 20 s · rest · T_base 40 N · T_tip 28 N")
    loop, other = all_of(shown, "figure:not(.playback)")
    assert not loop.is_displayed() and other.is_displayed()
    assert len(all_of(shown, ".playback canvas")) == 8
    assert [heading.text for heading in all_of(shown, ".playback > h2")] == ["Space"]
    assert all(inked(shown, canvas) > 1000 for canvas in all_of(shown, ".playback canvas"))
    (button,) = all_of(shown, "button.pictures")
    button.click()
    assert loop.is_displayed() and button.get_attribute("aria-expanded") == "true"
    button.click()
    assert not loop.is_displayed()


def test_slider_keys_and_clicks_go_through_the_history(shown):
    slider = all_of(shown, ".playback input")[0]
    body, loop, tensions = all_of(shown, ".playback canvas")[:3]
    before = body.screenshot_as_png, loop.screenshot_as_png, tensions.screenshot_as_png
    assert body.get_attribute("data-step") == "1"
    slider.send_keys(keys().ARROW_RIGHT, keys().ARROW_RIGHT)
    assert told(shown).startswith("sample 43 of 121, time 21 s")
    assert slider.get_attribute("aria-valuetext") == told(shown)
    slider.send_keys(keys().END)
    assert told(shown).startswith("sample 121 of 121, time 60 s") and "gap no reading" in told(shown)
    assert body.get_attribute("data-step") == "2"
    after = body.screenshot_as_png, loop.screenshot_as_png, tensions.screenshot_as_png
    assert all(a != b for a, b in zip(before, after, strict=True)), "all parts follow"
    tensions.send_keys(keys().ARROW_LEFT)
    assert told(shown).startswith("sample 120 of 121")
    tensions.send_keys(keys().HOME)
    assert told(shown).startswith("sample 1 of 121") and body.get_attribute("data-step") == "0"
    actions(shown).move_to_element(tensions).click().perform()
    assert abs(int(told(shown).split()[1]) - in_the_middle(tensions)) <= 1, "a click goes to what is under it"
    # The other playback has a history of its own.
    assert told(shown, 1).startswith("sample 1 of 121")


def test_a_chart_zooms_by_box_wheel_keys_and_buttons(shown):
    _, loop, tensions, rest = all_of(shown, ".playback canvas")[:4]
    reset = loop.find_elements("xpath", "../div/button")[2]
    shown.execute_script("arguments[0].scrollIntoView({block: 'center'})", loop)
    assert not reset.is_enabled()
    drag = actions(shown).move_to_element(loop).move_by_offset(-80, -60).click_and_hold()
    drag.move_by_offset(120, 90).release().perform()
    x0, x1, y0, y1 = range_of(loop)
    assert 0 < x0 < x1 < 40 and 0 < y0 < y1 < 28 and reset.is_enabled()
    reset.click()
    whole = range_of(loop)
    assert whole[0] < 0 and whole[1] > 40 and not reset.is_enabled()
    loop.send_keys("+")
    closer = range_of(loop)
    assert closer[1] - closer[0] == pytest.approx(0.6 * (whole[1] - whole[0]), rel=1e-6)
    loop.send_keys("0")
    assert range_of(loop) == whole

    def wheel(canvas, by):
        from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

        actions(shown).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, by).perform()
        time.sleep(0.2)

    wheel(loop, -200)  # it has the focus
    closer = range_of(loop)
    assert closer[1] - closer[0] == pytest.approx(np.exp(-0.5) * (whole[1] - whole[0]), rel=0.01)
    # Charts over time share it, and the page scrolls over a chart that is not in use.
    tensions.send_keys("+")
    assert range_of(rest)[:2] == range_of(tensions)[:2]
    again = [canvas.find_elements("xpath", "../div/button")[2] for canvas in (tensions, rest)]
    assert all(button.is_enabled() for button in again)
    again[0].click()
    assert not any(button.is_enabled() for button in again), "both show all of the time"
    before, top = range_of(rest), shown.execute_script("return window.scrollY")
    wheel(rest, 100)
    assert range_of(rest) == before and shown.execute_script("return window.scrollY") > top
    shown.execute_script("document.activeElement.blur()")


def test_the_sample_under_the_mouse_is_told_with_units(shown):
    tensions = all_of(shown, ".playback canvas")[2]
    (hint, *_) = tensions.find_elements("xpath", "../div[@class='hint']")
    assert not hint.is_displayed()
    actions(shown).move_to_element(tensions).perform()
    lines = hint.text.splitlines()
    assert hint.is_displayed() and abs(int(lines[0].split()[1]) - in_the_middle(tensions)) <= 1
    assert lines[0].endswith(" s")
    assert lines[1] == "T_base 40 N" and lines[2] == "T_tip 28 N"
    assert "sample 41 of" in told(shown), "looking is not going there"


def test_the_history_plays_pauses_and_ends(shown):
    slider, button = all_of(shown, ".playback input")[0], all_of(shown, ".playback > .controls button")[0]
    button.click()
    assert "Pause" in button.text
    time.sleep(0.8)
    button.click()
    at = int(told(shown).split()[1])
    assert 43 < at < 90 and "Play" in button.text
    time.sleep(0.3)
    assert int(told(shown).split()[1]) == at
    slider.send_keys(keys().END, keys().ARROW_LEFT)
    button.click()
    time.sleep(0.4)
    assert "sample 121 of" in told(shown) and "Play" in button.text


def test_a_body_in_space_follows_and_turns(shown):
    body, slider = all_of(shown, ".playback canvas")[4], all_of(shown, ".playback input")[1]
    shown.execute_script("arguments[0].scrollIntoView({block: 'center'})", body)
    still = inked(shown, body)
    slider.send_keys(keys().END)
    assert inked(shown, body) != still
    before = body.screenshot_as_png
    body.send_keys(keys().ARROW_RIGHT)
    assert body.screenshot_as_png != before and told(shown, 1).startswith("sample 121")


def test_print_has_the_pictures_and_all_that_is_folded(shown):
    loop, other = all_of(shown, "figure:not(.playback)")
    shown.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert loop.is_displayed() and other.is_displayed()
        assert not any(each.is_displayed() for each in all_of(shown, ".playback"))
        paper = shown.execute_cdp_cmd("Page.printToPDF", {})["data"]
    finally:
        shown.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert base64.b64decode(paper).startswith(b"%PDF")


def test_nothing_is_wider_than_a_phone(shown):
    wide = {"width": 400, "height": 800, "deviceScaleFactor": 2, "mobile": False}
    shown.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", wide)
    try:
        time.sleep(0.2)
        assert shown.execute_script("return document.documentElement.scrollWidth") <= 400
        assert all(200 < c.size["width"] <= 400 for c in all_of(shown, ".playback canvas"))
    finally:
        shown.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_without_scripts_the_pictures_stand(page, tmp_path):
    with opened(tmp_path, scripts=False) as browser:
        browser.get((page / "report.html").as_uri())
        loop, other = all_of(browser, "figure:not(.playback)")
        assert loop.is_displayed() and other.is_displayed()
        assert not any(each.is_displayed() for each in all_of(browser, ".playback, .turning canvas"))


def test_whoever_wants_little_motion_gets_few_stills(page, tmp_path):
    with opened(tmp_path, calm=True) as browser:
        browser.get((page / "report.html").as_uri())
        all_of(browser, ".playback input")[0].send_keys(keys().HOME)
        all_of(browser, ".playback > .controls button")[0].click()
        seen = set()
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            seen.add(told(browser))
            time.sleep(0.02)
        assert 2 <= len(seen) <= 4, "one still in 0.6 s"
