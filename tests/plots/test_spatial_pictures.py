"""Pictures of bodies in space, from made-up shapes."""

import base64
import hashlib
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from gtr_jax.plots.style import png
from gtr_jax.plots.views import Posture, Strung, drawn, plot_views
from gtr_jax.report.page import SCRIPT, Report, render
from gtr_jax.report.scene import scene

LENGTH, N = 0.25, 41
STRAIN = np.array([3.0, 5.0, -4.0])
MARKERS = np.array([[0.1, 0.02, 0.03], [0.2, -0.01, 0.01]])
SETTINGS = {"command": "gtr", "inputs": {}, "started": "", "versions": {}}


def hat(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def made_up(name, share):
    """A body of constant strain, a helix; two tendons."""
    from scipy.linalg import expm

    twist = np.zeros((4, 4))
    twist[:3, :3], twist[0, 3] = hat(share * STRAIN), 1.0
    poses = np.array([expm(twist * s) for s in BODY.s])
    tension = np.stack([10 * share * np.exp(-BODY.s), np.full(N, 2.0 * share)])
    return Posture(name, poses[:, :3, 3], poses[:, :3, :3], tension, MARKERS)


S = np.linspace(0.0, LENGTH, N)
ANGLE = 2 * np.pi * S / LENGTH
OFFSETS = np.stack([0.008 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1), np.tile([0.0, 0.006], (N, 1))])
BODY = Strung(S, np.linspace(0.012, 0.008, N), OFFSETS, np.array([LENGTH, 0.2]), ("wound", "short"))


def test_between_the_nodes_the_shape_is_that_of_the_closed_form():
    from scipy.linalg import expm

    shape = drawn(BODY, made_up("bent", 1.0), points=33)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[0, 3] = hat(STRAIN), 1.0
    for i in (5, 17, 31):
        at = shape.s[i]
        pose = expm(twist * at)
        turn = 2 * np.pi * at / LENGTH
        place = pose @ [0, 0.008 * np.cos(turn), 0.008 * np.sin(turn), 1]
        np.testing.assert_allclose(shape.middle[i], 1e3 * pose[:3, 3], atol=1e-4)
        np.testing.assert_allclose(shape.channels[0, i], 1e3 * place[:3], atol=2e-3)
        radius = np.linalg.norm(shape.sections[i] - shape.middle[i], axis=1)
        np.testing.assert_allclose(radius, 12 - 4 * at / LENGTH, rtol=1e-6)


def test_three_views_share_one_scale():
    fig = plot_views(BODY, [made_up("at rest", 0.0), made_up("pulled", 1.0), made_up("end", 0.5)])
    fig.canvas.draw()
    views = fig.axes[:3]
    assert [(a.get_xlabel()[0], a.get_ylabel()[0]) for a in views] == [("x", "y"), ("x", "z"), ("y", "z")]
    scales = []
    for axes in views:
        box = axes.get_window_extent()
        scales += [box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-6)
    assert "[mm]" in views[0].get_xlabel() and fig.axes[3].get_ylabel() == "tension [N]"
    assert len(png(fig)) > 10_000


def page():
    postures = [made_up(f"step {k}", k / 80) for k in range(81)]
    body = scene(BODY, postures, first=33, caption="Turn it <script>.")
    return body, render(Report(title="t", verdict="v", scenes=[body]), SETTINGS, None)


def test_the_page_that_turns_loads_nothing_and_runs_this_script_only():
    body, html = page()
    digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)
    assert policy and "default-src 'none'" in policy[1] and f"script-src 'sha256-{digest}'" in policy[1]
    assert f"<script>{SCRIPT}</script>" in html
    assert "http://" not in html and "https://" not in html and "<noscript>" in html
    assert len(html) < 1_000_000 and "Turn it &lt;script&gt;." in html
    assert body.data["steps"][body.data["first"]]["label"] == "step 33"
    assert len(body.data["steps"]) <= 61 and body.data["ends"] == [60, 48]


def test_a_page_without_a_body_to_turn_runs_no_script():
    html = render(Report(title="t", verdict="v"), SETTINGS, None)
    assert "script" not in html


STUB = """
const calls = [];
const pen = new Proxy({}, { get: (_, name) => (...of) => { calls.push([String(name), of]); },
                            set: () => true });
const element = (kind) => ({ kind, style: {}, children: [], on: {}, clientWidth: 700, clientHeight: 400,
  append(...more) { this.children.push(...more); }, prepend(...more) { this.children.push(...more); },
  setAttribute() {}, setPointerCapture() {}, getContext: () => pen,
  addEventListener(name, run) { this.on[name] = run; } });
const figure = element("figure");
figure.querySelector = () => ({ textContent: DATA });
globalThis.window = { devicePixelRatio: 1, addEventListener() {} };
globalThis.document = { createElement: element,
                        querySelectorAll: (what) => (what === ".turning" ? [figure] : []) };
PROGRAM
const [canvas, controls] = figure.children;
const button = controls.children.find((c) => c.textContent === "x, z");
const seen = (act) => { calls.length = 0; act();
  const squares = calls.filter((c) => c[0] === "fillRect" && c[1][2] === 6 && c[1][3] === 6);
  return squares.map((c) => c[1]).sort((a, b) => a[0] - b[0]); };
const flat = seen(button.on.click);
const after = seen(() => { canvas.on.pointerdown({ clientX: 0, clientY: 0, pointerId: 1 });
                           canvas.on.pointermove({ clientX: 40, clientY: 0 }); });
const later = controls.children[0];
later.value = 0;
later.on.input();
console.log(JSON.stringify({ flat, after, said: controls.children[1].textContent, drawn: calls.length }));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_draws_and_turns():
    body, _ = page()
    program = STUB.replace("PROGRAM", SCRIPT).replace("DATA", json.dumps(json.dumps(body.data)))
    done = subprocess.run(
        ["node", "-"], input=program, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["said"] == "step 0" and answer["drawn"] > 1000
    assert answer["flat"] != answer["after"], "the mouse turns it"
    # Seen along y, markers stand apart to the right by their x and up by their z, at one scale.
    (left, low), (right, high) = (place[:2] for place in answer["flat"])
    assert 0 < left < right < 700 and 0 < min(low, high) < max(low, high) < 400
    assert (high - low) / (right - left) == pytest.approx(-(0.01 - 0.03) / (0.2 - 0.1), rel=1e-6)
