"""The live page in a browser, and who is let in."""

import contextlib
import http.client
import os
import re
import signal
import stat
import subprocess
import sys
import time
import urllib.error
import urllib.request
from http.cookiejar import CookieJar
from pathlib import Path

import numpy as np
import pytest
from command_line import RECORDED, RECORDING

import gtr_jax as gtr
from benchmarks.browser import chromium, found

# Begins the scripts that run in the page.
NAMED = "const model = name => Bokeh.documents[0].get_model_by_name(name);"
WAIT = 60.0  # seconds
RIG = Path(__file__).parents[2] / "examples" / "rig"


def next_address(stream):
    """The next address that the command prints, which lets one browser in."""
    lines = []
    while lines[-1:] != [""]:
        lines.append(stream.readline())
        if found := re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", lines[-1]):
            return found[0]
    raise AssertionError("".join(lines))


@contextlib.contextmanager
def serving(out, *files):
    """The command at work, and the address that it prints."""
    command = [sys.executable, "-m", "gtr_jax", "view", *files, "--no-browser", "-o", out]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    try:
        yield process, next_address(process.stdout)
    finally:  # a test that is skipped or fails leaves it, too
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The command at work, its address, and the folder that it writes to."""
    out = tmp_path_factory.mktemp("view") / "out"
    with serving(out, RECORDED, RECORDING) as (process, address):
        yield process, address, out


def answer(address, opener=None, **headers):
    """Status and text of what is served there."""
    request = urllib.request.Request(address, headers=headers)
    try:
        with (opener or urllib.request.build_opener()).open(request, timeout=60) as response:
            return response.status, response.read().decode()
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code, refused.read().decode()


def another_address(served):
    """An address that no browser has used: one is printed whenever the last one was."""
    process, address, _ = served
    answer(address)  # unless another test has used it
    return next_address(process.stderr)


def test_nothing_is_served_without_the_token(served):
    _, address, _ = served
    bare = address.partition("?")[0]
    asked = [bare, f"{bare}?token=", f"{bare}?token=wrong", f"{bare}ws", f"{bare}static/js/bokeh.min.js"]
    for place in [*asked, f"{bare}runs/robot.toml", f"{bare}metadata", address.replace("/?", "/ws?")]:
        status, text = answer(place)
        assert status == 403 and "with its token" in text
    port = bare.rpartition(":")[2].rstrip("/")
    status, _ = answer(bare, Cookie=f"gtr-view-{port}=wrong")
    assert status == 403
    jar = CookieJar()
    known = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
    status, welcome = answer(address, known)
    assert status == 200 and "<h1>" not in welcome
    status, page = answer(bare, known)
    assert status == 200 and "<h1>" in page
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)
    # Its key served once, and the secrets are others.
    assert answer(address)[0] == 403
    token, acting = address.partition("token=")[2], secret_of(welcome)
    (cookie,) = jar
    assert cookie.has_nonstandard_attr("HttpOnly") and cookie.get_nonstandard_attr("SameSite") == "Strict"
    assert cookie.value and len({token, cookie.value, acting}) == 3
    assert not any(secret in page for secret in (token, cookie.value, acting))


def secret_of(welcome):
    """The secret that a browser is given for sockets."""
    found = re.search(r'setItem\("gtr-view", "(\S+)"\)', welcome)
    assert found, welcome
    return found[1]


def connected(bare, cookie, protocols):
    """Status of the answer to a browser that asks for a socket."""
    headers = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
    headers |= {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": protocols}
    link = http.client.HTTPConnection(bare.split("/")[2], timeout=60)
    try:
        link.request("GET", "/ws", headers=headers | {"Cookie": cookie, "Origin": bare.rstrip("/")})
        return link.getresponse().status
    finally:
        link.close()


def test_a_socket_needs_more_than_the_cookie_that_other_ports_are_sent(served):
    bare = served[1].partition("?")[0]
    jar = CookieJar()
    known = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
    acting = secret_of(answer(another_address(served), known)[1])
    (cookie,) = jar
    sent, session = f"{cookie.name}={cookie.value}", re.search(r'"token":"([^"]+)"', answer(bare, known)[1])
    assert session
    usual = f"bokeh, {session[1]}"
    for protocols in (usual, f"{usual}, gtr.", f"{usual}, gtr.null", f"{usual}, gtr.{cookie.value}"):
        assert connected(bare, sent, protocols) == 403
    assert connected(bare, "", f"{usual}, gtr.{acting}") == 403
    assert connected(bare, sent, f"{usual}, gtr.{acting}") == 101
    # Pages of other ports may not hold the page in a frame, and do not know where reports are.
    with known.open(bare, timeout=60) as response:
        assert response.headers["X-Frame-Options"] == "DENY"
        assert response.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert answer(f"{bare}runs/robot.toml", known)[0] == 404


@pytest.mark.skipif(os.name != "posix", reason="modes of files are of no matter there")
def test_the_browser_is_started_with_a_file_that_only_the_user_can_read(tmp_path, monkeypatch):
    paths = found()
    if paths is None:
        pytest.skip("no Chromium with its driver on this machine")
    browser, told = tmp_path / "browser", tmp_path / "told"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > {told}.part && mv {told}.part {told}\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    command = [sys.executable, "-m", "gtr_jax", "view", RECORDED, "-o", tmp_path / "out"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            printed = next_address(process.stdout)
            end = time.monotonic() + WAIT
            while not told.exists() and time.monotonic() < end:
                time.sleep(0.05)
            address = told.read_text()
            assert address.startswith("file://") and "token" not in address
            file = Path(urllib.request.url2pathname(address.removeprefix("file://")))
            assert stat.S_IMODE(file.stat().st_mode) == 0o600
            assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
            assert printed.partition("token=")[2] not in file.read_text()
            with opened(address, tmp_path / "chromium") as page:
                assert "token" not in page.chrome.current_url
                assert not file.exists()
                # Reloaded, and in another tab of the same browser.
                for way in ("refresh", "another"):
                    here = page.chrome.current_url
                    if way == "refresh":
                        page.chrome.refresh()
                    else:
                        page.chrome.switch_to.new_window("tab")
                        page.chrome.get(here)
                    page.until(lambda: "load steps" in page.text("status"), way)
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)


class Tab:
    """The page in a browser."""

    def __init__(self, chrome):
        self.chrome = chrome

    def run(self, script, *arguments):
        return self.chrome.execute_script(NAMED + script, *arguments)

    def get(self, name, attribute):
        return self.run("return model(arguments[0])?.[arguments[1]]", name, attribute)

    def set(self, name, attribute, value):
        self.run("model(arguments[0])[arguments[1]] = arguments[2]", name, attribute, value)

    def text(self, name):
        return re.sub("<[^>]*>", "", self.get(name, "text") or "")

    def column(self, name):
        """A column of the samples."""
        return self.run("return [...model('samples').get_array(arguments[0])]", name)

    def element(self, name, selector):
        """Something within what a model looks like."""
        script = """
        const look = view => view.model.name === arguments[0] ? view
          : (view.child_views ?? []).map(look).find(found => found)
        const view = Object.values(Bokeh.index).concat([...(Bokeh.index.roots ?? [])]).map(look).find(v => v)
        return view.shadow_el.querySelector(arguments[1])
        """
        return self.run(script, name, selector)

    def until(self, condition, what, seconds=WAIT):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if condition():
                    return
            except Exception:
                if time.monotonic() > end - 1:
                    raise
            time.sleep(0.05)
        raise AssertionError(f"{what}: not within {seconds:.0f} s; the page says {self.text('status')!r}")


@contextlib.contextmanager
def opened(address, profile, **window):
    """The page in a browser, its first curves drawn."""
    paths = found()
    if paths is None:
        pytest.skip("no Chromium with its driver on this machine; apt-get install chromium chromium-driver")
    with chromium(paths, profile, **window) as chrome:
        chrome.get(address)
        page = Tab(chrome)
        page.until(lambda: "load steps" in page.text("status"), "first curves")
        yield page


@pytest.fixture(scope="module")
def tab(served, tmp_path_factory):
    with opened(another_address(served), tmp_path_factory.mktemp("chromium")) as page:
        yield page


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """The page of a recording of more than tensions, in a narrow window."""
    folder = tmp_path_factory.mktemp("narrow")
    with serving(folder / "out", RIG / "robot.toml", RIG / "tuesday.csv") as (_, address):
        with opened(address, folder / "chromium", width=600, height=900) as page:
            yield page


def expected(**values):
    """Largest tip tension of the robot through the recording, as the page pulls it."""
    from gtr_jax.app.view.histories import recorded

    robot = gtr.load_robot(RECORDED).with_values(**values)
    history = recorded(robot, gtr.read_recording(RECORDING))
    return float(gtr.simulate(robot, history.T_base, time=history.time).T_tip.max())


def test_a_slider_moved_by_key_moves_the_curves(tab):
    first = max(tab.column("T_tip_0"))
    assert first == pytest.approx(expected(), rel=1e-6)
    handle = tab.element("mu", ".noUi-handle")
    for _ in range(3):
        handle.send_keys("\ue014")  # arrow to the right
    step = tab.get("mu", "step")
    value = float(gtr.load_robot(RECORDED).value("mu")) + 3 * step
    tab.until(lambda: tab.get("mu", "value") == pytest.approx(value, abs=step / 2), "slider")
    wanted = expected(mu=tab.get("mu", "value"))
    tab.until(lambda: max(tab.column("T_tip_0")) == pytest.approx(wanted, rel=1e-6), "curves")
    assert tab.get("mu field", "value") == pytest.approx(tab.get("mu", "value"))
    assert "ms" in tab.text("status")


def test_a_number_typed_beyond_the_slider_widens_it(tab):
    tab.set("mu field", "value", 2.5)
    tab.until(lambda: max(tab.column("T_tip_0")) == pytest.approx(expected(mu=2.5), rel=1e-6), "curves")
    assert tab.get("mu", "end") >= 2.5
    tab.set("mu field", "value", 0.3)
    tab.until(lambda: max(tab.column("T_tip_0")) == pytest.approx(expected(mu=0.3), rel=1e-6), "curves")


def test_brushed_samples_show_the_body_there(tab):
    before = tab.run("return [...model('midline').get_array('y')]")
    tab.run("model('samples').selected.indices = [3, 4, 5]")
    tab.until(lambda: tab.get("step", "value") == 6, "step")
    time_s, T_base = tab.column("time")[5], tab.column("T_base_0")[5]
    assert tab.text("here").startswith(f"t = {time_s:.4g} s: T_base {T_base:.3g} N")
    assert tab.run("return [...model('midline').get_array('y')]") != before
    assert len(tab.run("return [...model('brushed midlines').get_array('ys')]")) == 3
    tab.run("model('samples').selected.indices = []")
    tab.until(lambda: not tab.run("return [...model('brushed midlines').get_array('ys')]"), "let go")


def test_curves_are_kept_as_a_ghost_and_taken_back(tab):
    kept = tab.get("mu", "value")
    tab.set("ghost name", "value", "less friction")
    tab.element("keep ghost", "button").click()
    tab.until(lambda: tab.element("remove less friction", "button"), "ghost")
    tab.set("mu", "value", 0.45)
    tab.until(lambda: max(tab.column("T_tip_0")) == pytest.approx(expected(mu=0.45), rel=1e-6), "curves")
    tab.element("take back less friction", "button").click()
    tab.until(lambda: max(tab.column("T_tip_0")) == pytest.approx(expected(mu=kept), rel=1e-6), "curves")
    assert tab.get("mu", "value") == pytest.approx(kept)


def test_a_term_is_added_at_null_and_taken_away(tab):
    before = tab.column("T_tip_0")
    tab.set("add term", "value", "tip-gain")
    tab.until(lambda: tab.get("tip-gain.gain", "value") == 1, "term")
    tab.set("tip-gain.gain", "value", 1.05)
    tab.until(lambda: tab.column("T_tip_0")[50] == pytest.approx(1.05 * before[50], rel=1e-6), "gain")
    tab.element("remove tip-gain", "button").click()
    tab.until(lambda: tab.column("T_tip_0") == pytest.approx(before), "no gain")


def test_the_robot_is_saved_and_never_over_another(tab, served):
    out = served[2]
    tab.set("file name", "value", "mine")
    tab.element("save", "button").click()
    tab.until(lambda: tab.text("saved").startswith("written"), "file")
    robot = gtr.load_robot(out / "mine.toml")
    assert float(robot.value("mu")) == pytest.approx(tab.get("mu", "value"))
    contents = (out / "mine.toml").read_bytes()
    tab.element("save", "button").click()
    tab.until(lambda: "choose another name" in tab.text("saved"), "refusal")
    assert (out / "mine.toml").read_bytes() == contents


def test_a_robot_that_no_command_takes_is_not_saved_nor_fitted(tab, served):
    before = tab.get("r1", "value")
    tab.set("r1", "value", -25)
    tab.until(lambda: tab.text("status").startswith("No command takes this robot"), "warning")
    line = tab.text("status").partition(": ")[2]
    assert "the tendon leaves the body at s = " in line
    tab.set("file name", "value", "outside")
    for button, says in (("save", "saved"), ("fit", "run status"), ("diagnose", "run status")):
        tab.element(button, "button").click()
        tab.until(lambda says=says: tab.text(says) == f"Not done: {line}", button)
        tab.set("run status", "text", "")
    assert not (served[2] / "outside.toml").exists()
    assert not [*served[2].glob("fit*"), *served[2].glob("diagnose*")]
    tab.set("r1", "value", before)
    tab.until(lambda: "load steps" in tab.text("status"), "no warning")


def test_a_hand_pulls_and_begins_again(tab):
    tab.set("way", "active", 2)
    tab.until(lambda: tab.column("T_base_0") == [0.0], "rest")
    for moves in ([3.0], [3.0, 5.0], [3.0, 5.0, 4.0]):
        tab.set("hand 0", "value", moves[-1])
        tab.until(lambda m=moves: tab.column("T_base_0") == pytest.approx([0.0, *m]), f"{moves}")
    pulled = gtr.load_robot(RECORDED).with_values(mu=tab.get("mu", "value"))
    wanted = np.asarray(gtr.simulate(pulled, [0.0, 3.0, 5.0, 4.0]).T_tip)
    assert tab.column("T_tip_0") == pytest.approx(wanted, rel=1e-6)
    tab.element("begin again", "button").click()
    tab.until(lambda: tab.column("T_base_0") == [0.0] and tab.get("hand 0", "value") == 0, "rest")
    tab.set("way", "active", 0)
    tab.until(lambda: len(tab.column("time")) > 4, "recording")


def test_a_diagnosis_from_the_page_runs_until_it_is_stopped(tab, served):
    tab.element("diagnose", "button").click()
    tab.until(lambda: tab.get("stop", "visible") and tab.get("diagnose", "disabled"), "start")
    assert (served[2] / "diagnose-1.toml").exists()
    tab.until(lambda: "<br>" in tab.get("run status", "text"), "a stage")
    assert tab.text("run status").startswith("gtr diagnose ")
    tab.element("stop", "button").click()
    tab.until(lambda: not tab.get("stop", "visible"), "end")
    assert not tab.get("diagnose", "disabled") and not tab.get("fit", "disabled")
    assert tab.text("run status").startswith("Not done: ")


def test_all_is_loaded_from_this_machine_and_named_for_screen_readers(tab, served):
    names = tab.run("return performance.getEntriesByType('resource').map(entry => entry.name)")
    here = served[1].partition("?")[0]
    assert names and all(name.startswith(here) for name in names)
    assert [entry for entry in tab.chrome.get_log("browser") if entry["level"] == "SEVERE"] == []
    assert "token" not in tab.chrome.current_url
    sliders = "[...Bokeh.documents[0]._all_models.values()].filter(m => m.type.endsWith('Slider'))"
    named = tab.run(f"return {sliders}.map(m => m.html_attributes['aria-label'])")
    assert named and all(named)


def test_a_history_alone_is_shown_and_not_fitted(tmp_path):
    T_base = np.concatenate([np.linspace(0.0, 8.0, 30), np.linspace(8.0, 1.0, 30)])
    table = np.stack([np.arange(60.0), T_base], axis=1)
    np.savetxt(tmp_path / "history.csv", table, delimiter=",", header="time_s,T_base_N", comments="")
    with serving(tmp_path / "out", RIG / "robot.toml", tmp_path / "history.csv") as (_, address):
        with opened(address, tmp_path / "chromium") as page:
            assert page.column("T_base_0") == pytest.approx(T_base, abs=1e-6)
            assert not page.get("residual", "visible") and not page.get("residual of", "visible")
            for button in ("fit", "diagnose"):
                assert page.get(button, "disabled")
                assert "T_tip_N" in page.get(button, "html_attributes")["title"]


def test_a_narrow_page_begins_with_the_body_and_the_loop(narrow):
    place = """
    const [body, loop, aside] = [".body", ".loop", "aside"].map(name => document.querySelector(name))
    const at = element => element.getBoundingClientRect()
    const page = document.documentElement
    scrollTo(0, 0)
    const found = [at(body).top, at(body).bottom, at(loop).top, at(loop).bottom, at(aside).top]
    scrollTo(0, at(aside).top + 200)
    return [found, at(body).bottom, innerHeight, page.scrollWidth - page.clientWidth]
    """
    (top, bottom, loop, end, sliders), stays, height, aside = narrow.run(place)
    assert 0 < top < bottom <= loop < end <= sliders
    assert end < 2 * height
    assert 0.3 * height < stays < 0.7 * height  # in sight beside the sliders
    assert aside <= 0
    narrow.run("scrollTo(0, 0)")


def test_the_residual_is_of_whatever_was_recorded(narrow):
    recording = gtr.read_recording(RIG / "tuesday.csv")
    choices = dict(narrow.get("residual of", "options"))
    assert [*choices] == ["T_tip", "tip_angle", "displacement"]
    for quantity, size in (("tip_angle", np.radians(1.0)), ("displacement", 1e-3)):
        words = choices[quantity]
        narrow.set("residual of", "value", quantity)
        values = getattr(recording, quantity) / size
        title = f"Simulated minus recorded: {words}"
        narrow.until(lambda t=title: narrow.run("return model('residual').title.text") == t, quantity)
        assert narrow.column("recorded_traced_0") == pytest.approx(values)
        residual = np.array(narrow.column("traced_0")) - values
        assert narrow.column("residual_0") == pytest.approx(residual, abs=1e-9)


@pytest.mark.slow
def test_a_fit_from_the_page_lands_on_the_sliders(tab, served):
    tab.set("free", "value", ["mu"])
    time.sleep(1)  # the button moves as the choice above it grows
    tab.element("fit", "button").click()
    tab.until(lambda: "Report of fit-1" in tab.text("run status"), "fit", 300)
    fitted = gtr.load_robot(served[2] / "fit-1" / "fitted.toml")
    assert tab.get("mu", "value") == pytest.approx(float(fitted.value("mu")))
    report = re.search(r'href="(runs-[^"]+/fit-1/report.html)"', tab.get("run status", "text"))
    assert report
    tab.chrome.get(served[1].partition("?")[0] + report[1])
    assert fitted.name in tab.chrome.title
    # Its scripts run, and reach nothing of the page.
    assert tab.chrome.execute_script("return origin") == "null"


def test_it_closes_on_an_interruption(served):
    process, address, _ = served
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert process.stderr.read().endswith("closing\n")
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=5)
