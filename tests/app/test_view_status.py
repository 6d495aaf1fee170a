"""What the page says below its title, and what it computes for that, without a browser."""

import threading
import time
import warnings
from typing import Any

import pytest
from bokeh.document import Document
from conftest import SINE

import gtr_jax as gtr
from gtr_jax.app.view import page as page_module
from gtr_jax.app.view.model import Setting
from gtr_jax.app.view.page import Given, Page
from gtr_jax.app.view.thread_warnings import thread_warnings

WAIT = 60.0  # seconds


class Tab:
    """A page, whose callbacks run when `until` is asked to wait for something."""

    def __init__(self, config, out):
        self.document = Document()
        self.page = Page(self.document, Given(config, None, [], out))

    def get(self, name) -> Any:
        return self.document.get_model_by_name(name)

    @property
    def status(self):
        return self.get("status").text

    def pump(self):
        for own in list(self.document.session_callbacks):
            self.document.callbacks.remove_session_callback(own)
            own.callback()

    def until(self, condition):
        end = time.monotonic() + WAIT
        while not condition():
            assert time.monotonic() < end, self.status
            self.pump()
            time.sleep(0.002)


@pytest.fixture
def opened(tmp_path):
    tabs = []

    def opening(config):
        tabs.append(Tab(config, tmp_path / "out"))
        return tabs[-1]

    yield opening
    for tab in tabs:
        tab.page.close()
        tab.page.wait()


@pytest.fixture
def shown(opened, make_config):
    tab = opened(make_config(routing=SINE))
    tab.until(lambda: "load steps" in tab.status)
    return tab


def test_a_late_judgement_does_not_hide_that_nothing_newer_is_shown(shown, monkeypatch):
    judging, go_on, done = threading.Event(), threading.Event(), threading.Event()
    simulated, written = page_module.simulated, Setting.written

    def broken(setting, history):
        if setting.values.get("mu") == 0.5:
            raise ValueError("nothing converged")
        return simulated(setting, history)

    def slow(setting, *free):
        judging.set()
        assert go_on.wait(WAIT)
        try:
            return written(setting, *free)
        finally:
            done.set()

    monkeypatch.setattr(page_module, "simulated", broken)
    monkeypatch.setattr(Setting, "written", slow)
    shown.get("mu").value = 0.4
    shown.until(judging.is_set)
    shown.get("mu").value = 0.5
    shown.until(lambda: "Not shown" in shown.status)
    go_on.set()
    assert done.wait(WAIT)
    time.sleep(0.05)  # the judge's thread tells
    shown.pump()
    assert "Not shown" in shown.status and "nothing converged" in shown.status
    shown.get("mu").value = 0.31
    shown.until(lambda: "load steps" in shown.status)


def test_a_number_that_cannot_be_is_refused_until_something_newer_is_shown(shown):
    shown.get("mu").value = -1.0
    assert "Not shown" in shown.status
    shown.get("mu").value = 0.2
    shown.until(lambda: "load steps" in shown.status)


def test_that_no_command_takes_it_and_that_steps_failed_are_both_said(shown, monkeypatch):
    simulated = page_module.simulated

    def failing(setting, history):
        curves = simulated(setting, history)
        object.__setattr__(curves, "failed", 3)
        return curves

    monkeypatch.setattr(page_module, "simulated", failing)
    shown.get("r1").value = -25.0
    shown.until(lambda: "No command takes this robot" in shown.status)
    assert "3 of 81 steps did not converge" in shown.status


def test_a_ghost_is_compared_once_for_each_quantity(shown, monkeypatch):
    plotted, compared = page_module.plotted, []

    def counted(colour, curves, quantity):
        compared.append(colour)
        return plotted(colour, curves, quantity)

    monkeypatch.setattr(page_module, "plotted", counted)
    for name in ("one", "two"):
        shown.get("ghost name").value = name
        shown.page._ghosts._keep()
    for mu in (0.21, 0.22, 0.23):
        del compared[:]
        shown.get("mu").value = mu
        shown.until(lambda mu=mu: shown.page._shown[0].setting.values.get("mu") == mu)
        if mu != 0.21:
            assert compared == [""]


def test_a_warning_of_the_robot_stands_on_the_page_and_not_in_the_terminal(opened, make_config):
    bore = {"diameter": 0.02, "from": 0.0, "to": 0.05}
    printed = []
    with warnings.catch_warnings():
        warnings.simplefilter("always", gtr.errors.InputWarning)
        warnings.showwarning = lambda message, *more, **rest: printed.append(str(message))
        config = make_config(routing={**SINE, "r1": -0.015}, backbone={"bores": [bore]})
        tab = opened(config)
        tab.until(lambda: "load steps" in tab.status)
        assert "Warning" not in tab.status
        tab.get("r1").value = -5.0
        tab.until(lambda: "lies in a bore" in tab.status)
        assert "load steps" in tab.status and "No command" not in tab.status
    assert printed == []


def test_input_warnings_are_heard_in_one_thread_only():
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        seen = []
        warnings.showwarning = lambda message, *more, **rest: seen.append(str(message))
        with thread_warnings() as texts:
            for _ in range(2):
                warnings.warn("of input", gtr.errors.InputWarning, stacklevel=1)
            warnings.warn("of a library", UserWarning, stacklevel=1)
            other = threading.Thread(target=lambda: warnings.warn("elsewhere", gtr.errors.InputWarning, 1))
            other.start()
            other.join()
        warnings.warn("later", gtr.errors.InputWarning, stacklevel=1)
    assert texts == ["of input"]
    assert seen == ["of a library", "elsewhere", "later"]
