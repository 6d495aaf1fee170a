"use strict";
// Draws bodies that the reader turns with the mouse, a finger or the arrow keys. Of each body it reads:
//   scale: mm of one unit of "place"; most: largest tension [N]; names: of the tendons;
//   radius: of the body [mm], M values; offsets: of each channel in the section [mm], y and z at M places;
//   ends: how many of the M places each tendon reaches;
//   steps: place (x, y, z at M places), left and up (directors, in 1/10000, at M places), tension of
//   each tendon at M places, in thousandths of "most"; markers: places of markers, as "place".
// A body that stands alone has a slider of its own, and reads of each step its label too; one of a playback
// follows that.
const turningOf = (function () {
  const CORNERS = 14;
  const SIDES = { "x, y": [90, 90], "x, z": [90, 0], "y, z": [0, 0] };

  function triples(flat, scale) {
    const out = [];
    for (let i = 0; i < flat.length; i += 3) out.push([flat[i] * scale, flat[i + 1] * scale, flat[i + 2] * scale]);
    return out;
  }

  const along = (p, a, u, b, v) => p.map((x, k) => x + a * u[k] + b * v[k]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  // Places of a step's rings, channels and markers, [mm].
  function built(body, step) {
    const middle = triples(step.place, body.scale);
    const left = triples(step.left, 1e-4), up = triples(step.up, 1e-4);
    const rings = middle.map((p, i) => {
      const ring = [];
      for (let k = 0; k < CORNERS; k++) {
        const angle = (2 * Math.PI * k) / CORNERS;
        ring.push(along(p, body.radius[i] * Math.cos(angle), left[i], body.radius[i] * Math.sin(angle), up[i]));
      }
      return ring;
    });
    const channels = body.offsets.map((flat) =>
      middle.map((p, i) => along(p, flat[2 * i], left[i], flat[2 * i + 1], up[i])));
    return { middle, rings, channels, tension: step.tension, markers: triples(step.markers, body.scale) };
  }

  return function (body, link) {
    const steps = body.steps.map((step) => built(body, step));
    let shown = body.first || 0;
    const canvas = document.createElement("canvas");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The body in space; turn it with the mouse or the arrow keys.");
    const controls = document.createElement("div");
    controls.className = "controls";
    const said = document.createElement("span");
    const view = { yaw: 60, pitch: 25, zoom: 1 };
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (const step of steps) for (const ring of step.rings) for (const p of ring)
      for (let k = 0; k < 3; k++) { low[k] = Math.min(low[k], p[k]); high[k] = Math.max(high[k], p[k]); }
    const centre = low.map((v, k) => 0.5 * (v + high[k]));
    const size = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
    if (!link) controls.append(slider(), said);
    for (const [name, [yaw, pitch]] of Object.entries(SIDES)) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.addEventListener("click", () => { Object.assign(view, { yaw, pitch }); draw(); });
      controls.append(button);
    }

    function slider() {
      const made = document.createElement("input");
      Object.assign(made, { type: "range", min: 0, max: steps.length - 1, value: shown });
      made.setAttribute("aria-label", "step");
      made.addEventListener("input", () => step(Number(made.value)));
      return made;
    }

    function step(k) {
      shown = k;
      if (!link) said.textContent = body.steps[k].label;
      draw();
    }

    function draw() {
      const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, tall = canvas.clientHeight;
      if (!wide || !tall) return; // hidden, as in print
      canvas.width = wide * ratio;
      canvas.height = tall * ratio;
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      const yaw = (view.yaw * Math.PI) / 180, pitch = (view.pitch * Math.PI) / 180;
      const into = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), -Math.sin(pitch)];
      const right = [Math.sin(yaw), -Math.cos(yaw), 0];
      const up = [Math.sin(pitch) * Math.cos(yaw), Math.sin(pitch) * Math.sin(yaw), Math.cos(pitch)];
      const scale = (view.zoom * 0.9 * Math.min(wide, tall * 1.5)) / size;
      const seen = (p) => {
        const q = p.map((x, k) => x - centre[k]);
        return [0.5 * wide + scale * dot(q, right), 0.5 * tall - scale * dot(q, up), dot(q, into)];
      };
      const step = steps[shown], parts = [];
      const rings = step.rings.map((ring) => ring.map(seen));
      for (let i = 0; i + 1 < rings.length; i++) for (let k = 0; k < CORNERS; k++) {
        const l = (k + 1) % CORNERS, face = [rings[i][k], rings[i][l], rings[i + 1][l], rings[i + 1][k]];
        const out = step.rings[i][k].map((x, c) => x - step.middle[i][c]);
        const light = 190 - 55 * (dot(out, into) - 0.6 * dot(out, up)) / (Math.hypot(...out) || 1);
        const grey = Math.round(Math.min(Math.max(light, 140), 250));
        parts.push({ depth: 0.25 * face.reduce((sum, q) => sum + q[2], 0), face, fill: `rgba(${grey},${grey},${grey},0.4)` });
      }
      step.channels.forEach((channel, n) => {
        const places = channel.slice(0, body.ends[n]).map(seen);
        for (let i = 0; i + 1 < places.length; i++) parts.push({
          depth: 0.5 * (places[i][2] + places[i + 1][2]), line: [places[i], places[i + 1]],
          stroke: shades.colour((step.tension[n][i] + step.tension[n][i + 1]) / 2000), wide: 2.5,
        });
      });
      for (const marker of step.markers) { const p = seen(marker); parts.push({ depth: p[2], dot: p }); }
      parts.sort((a, b) => b.depth - a.depth);
      pen.lineCap = "round";
      for (const part of parts) {
        pen.beginPath();
        if (part.dot) {
          pen.fillStyle = "#d55e00";
          pen.fillRect(part.dot[0] - 3, part.dot[1] - 3, 6, 6);
        } else {
          const path = part.face || part.line;
          path.forEach((q, i) => (i ? pen.lineTo(q[0], q[1]) : pen.moveTo(q[0], q[1])));
          if (part.face) { pen.fillStyle = part.fill; pen.fill(); }
          else { pen.strokeStyle = part.stroke; pen.lineWidth = part.wide; pen.stroke(); }
        }
      }
      axes(pen, tall, right, up);
      shades.bar(pen, wide - 20, tall - 22, scale);
      shades.key(pen, wide - 30, 16, body.most);
    }

    function axes(pen, tall, right, up) {
      const from = [45, tall - 45];
      pen.font = "13px system-ui, sans-serif";
      ["x", "y", "z"].forEach((name, k) => {
        const to = [from[0] + 30 * right[k], from[1] - 30 * up[k]];
        pen.strokeStyle = pen.fillStyle = ["#d55e00", "#009e73", "#0072b2"][k];
        pen.lineWidth = 2;
        pen.beginPath();
        pen.moveTo(...from);
        pen.lineTo(...to);
        pen.stroke();
        pen.fillText(name, to[0] + 6 * right[k] - 3, to[1] - 9 * up[k] + 4);
      });
    }

    let held = null;
    canvas.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointerup", () => { held = null; });
    canvas.addEventListener("pointermove", (e) => {
      if (!held) return;
      turn(e.clientX - held[0], e.clientY - held[1]);
      held = [e.clientX, e.clientY];
    });
    canvas.addEventListener("wheel", (e) => {
      if (link && document.activeElement !== canvas && !e.ctrlKey) return; // the page scrolls, as over charts
      e.preventDefault();
      view.zoom = Math.min(Math.max(view.zoom * Math.exp(-e.deltaY / 500), 0.3), 20);
      draw();
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      const by = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, -10], ArrowDown: [0, 10] }[e.key];
      if (!by) return;
      e.preventDefault();
      turn(...by);
    });
    function turn(across, down) {
      view.yaw -= 0.5 * across;
      view.pitch = Math.min(Math.max(view.pitch + 0.5 * down, -90), 90);
      draw();
    }
    if (!link) window.addEventListener("resize", draw);
    return { canvas, controls, draw, step };
  };
})();

document.querySelectorAll(".turning").forEach((figure) => {
  const body = JSON.parse(figure.querySelector("script").textContent), made = turningOf(body, null);
  figure.prepend(made.canvas, made.controls);
  made.step(body.first || 0);
});
