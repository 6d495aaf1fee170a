"use strict";
// A canvas with axes that the reader zooms: by dragging a box, by the wheel while it has the focus or Ctrl is
// held, by the keys + - 0, and by buttons. What stands between the axes is drawn by others. Of `spec` it reads:
//   title; across, up: labels of the axes; says: what screen readers are told;
//   x, y: ranges that hold everything; equal: whether both axes have one scale; above: pixels above the axes.
// `on` holds: paint(pen, place), drawn between the axes, where place.x(v) and place.y(v) are pixels;
//   head(pen, place), drawn above them;
//   pick(px, py), a click; hover(px, py), or hover() when the mouse leaves; step(by), a key; zoomed(x), a new
//   range across.
const frameOf = (function () {
  const ROOM = { left: 56, right: 18, top: 10, bottom: 40 };
  const FONT = "12px system-ui, sans-serif", INK = "#222", FAINT = "#e6e6e6", AXIS = "#777";
  const STEPS = { ArrowLeft: -1, ArrowRight: 1, ArrowDown: -1, ArrowUp: 1, PageDown: -10, PageUp: 10,
    Home: -Infinity, End: Infinity };
  const LEAST = 6; // pixels of a box that is meant

  function ticks([low, high], most) {
    const rough = (high - low) / Math.max(most, 1), power = Math.pow(10, Math.floor(Math.log10(rough)));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
    const out = [];
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) out.push(k * step);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return out.map((v) => [v, Math.abs(v) < 1e-9 * step ? "0" : v.toFixed(Math.min(digits, 12)).replace("-", "−")]);
  }

  const same = (a, b) => a[0] === b[0] && a[1] === b[1];

  function button(text, says, act) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.setAttribute("aria-label", says);
    made.title = says;
    made.addEventListener("click", act);
    return made;
  }

  return function (spec, on) {
    const element = document.createElement("section");
    const head = document.createElement("div"), title = document.createElement("h3");
    const canvas = document.createElement("canvas");
    element.className = "frame";
    head.className = "head";
    title.textContent = spec.title;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", spec.says + " Arrow keys go through the history, + and - zoom, 0 shows all.");
    const view = { x: spec.x, y: spec.y };
    const reset = button("reset", "show all of " + spec.title, () => look(spec.x, spec.y));
    const about = (factor) => {
      const p = placed();
      zoom(factor, (p.left + p.right) / 2, (p.top + p.bottom) / 2);
    };
    head.append(title, button("+", "zoom into " + spec.title, () => about(0.6)),
      button("−", "zoom out of " + spec.title, () => about(1 / 0.6)), reset);
    element.append(head, canvas);

    // Pixels of the area between the axes, and of values.
    function placed() {
      const left = ROOM.left, right = canvas.clientWidth - ROOM.right;
      const top = ROOM.top + (spec.above || 0), bottom = canvas.clientHeight - ROOM.bottom;
      let [x, y] = [view.x, view.y];
      if (spec.equal) {
        const size = Math.max((x[1] - x[0]) / (right - left), (y[1] - y[0]) / (bottom - top));
        const about = ([a, b], pixels) => [(a + b - size * pixels) / 2, (a + b + size * pixels) / 2];
        [x, y] = [about(x, right - left), about(y, bottom - top)];
      }
      const across = (right - left) / (x[1] - x[0]), up = (bottom - top) / (y[1] - y[0]);
      return {
        left, right, top, bottom, seen: { x, y }, scale: across,
        x: (v) => left + across * (v - x[0]), y: (v) => bottom - up * (v - y[0]),
        back: (px, py) => [x[0] + (px - left) / across, y[0] + (bottom - py) / up],
      };
    }

    function look(x, y, quietly) {
      const moved = !same(x, view.x);
      Object.assign(view, { x, y });
      tell();
      reset.disabled = same(x, spec.x) && same(y, spec.y);
      draw();
      if (moved && !quietly && on.zoomed) on.zoomed(x);
    }

    function tell() {
      canvas.dataset.x = view.x.join(" ");
      canvas.dataset.y = view.y.join(" ");
    }

    function zoom(factor, px, py) {
      const p = placed(), at = p.back(px, py);
      const about = ([a, b], whole, v) => {
        const most = whole[1] - whole[0], size = Math.max(factor * (b - a), 1e-6 * most);
        // Beyond everything there is nothing to see.
        if (size >= most * 1.2) return whole;
        return [v - ((v - a) / (b - a)) * size, v + ((b - v) / (b - a)) * size];
      };
      look(about(p.seen.x, spec.x, at[0]), about(p.seen.y, spec.y, at[1]));
    }

    let box = null, held = null;
    function draw() {
      const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, tall = canvas.clientHeight;
      if (!wide || !tall) return; // hidden, as in print
      canvas.width = wide * ratio;
      canvas.height = tall * ratio;
      const pen = canvas.getContext("2d"), p = placed();
      pen.scale(ratio, ratio);
      pen.font = FONT;
      pen.lineWidth = 1;
      pen.strokeStyle = FAINT;
      pen.fillStyle = INK;
      pen.textAlign = "center";
      for (const [v, text] of ticks(p.seen.x, (p.right - p.left) / 80)) {
        line(pen, p.x(v), p.top, p.x(v), p.bottom);
        pen.fillText(text, p.x(v), p.bottom + 15);
      }
      pen.fillText(spec.across, (p.left + p.right) / 2, p.bottom + 33);
      pen.textAlign = "right";
      for (const [v, text] of ticks(p.seen.y, (p.bottom - p.top) / 45)) {
        line(pen, p.left, p.y(v), p.right, p.y(v));
        pen.fillText(text, p.left - 6, p.y(v) + 4);
      }
      pen.save();
      pen.translate(13, (p.top + p.bottom) / 2);
      pen.rotate(-Math.PI / 2);
      pen.textAlign = "center";
      pen.fillText(spec.up, 0, 0);
      pen.restore();
      pen.strokeStyle = AXIS;
      line(pen, p.left, p.bottom, p.right, p.bottom);
      line(pen, p.left, p.top, p.left, p.bottom);
      pen.save();
      pen.beginPath();
      pen.rect(p.left, p.top, p.right - p.left, p.bottom - p.top);
      pen.clip();
      pen.textAlign = "left";
      on.paint(pen, p);
      pen.restore();
      if (on.head) on.head(pen, p);
      if (!box) return;
      pen.fillStyle = "rgba(0,114,178,0.12)";
      pen.strokeStyle = "#0072b2";
      const [a, b] = box;
      pen.fillRect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
      pen.strokeRect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
    }

    function line(pen, a, b, c, d) {
      pen.beginPath();
      pen.moveTo(a, b);
      pen.lineTo(c, d);
      pen.stroke();
    }

    function pointer(e) {
      const at = canvas.getBoundingClientRect();
      return [e.clientX - at.left, e.clientY - at.top];
    }

    function boxed([a, b]) {
      const p = placed(), from = p.back(...a), to = p.back(...b);
      const side = (i, seen) =>
        Math.abs(a[i] - b[i]) < LEAST ? seen : [Math.min(from[i], to[i]), Math.max(from[i], to[i])];
      look(side(0, view.x), side(1, view.y));
    }

    function pan(by) {
      const p = placed(), from = p.back(0, 0), to = p.back(...by);
      const moved = (seen, i) => seen.map((v) => v - to[i] + from[i]);
      look(moved(view.x, 0), moved(view.y, 1));
    }

    canvas.addEventListener("pointerdown", (e) => {
      if (e.button) return;
      held = { from: pointer(e), at: pointer(e), pans: e.shiftKey, touch: e.pointerType === "touch" };
      if (!held.touch) canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", (e) => {
      const at = pointer(e);
      if (held && held.pans) pan([at[0] - held.at[0], at[1] - held.at[1]]);
      if (held && !held.pans && !held.touch) {
        box = Math.hypot(at[0] - held.from[0], at[1] - held.from[1]) < LEAST ? null : [held.from, at];
        draw();
      }
      if (held) held.at = at;
      if (on.hover && !box) on.hover(...at);
    });
    canvas.addEventListener("pointerup", (e) => {
      const chosen = box, still = held && Math.hypot(held.at[0] - held.from[0], held.at[1] - held.from[1]) < LEAST;
      box = held = null;
      if (chosen) boxed(chosen);
      else if (still && on.pick) on.pick(...pointer(e));
    });
    canvas.addEventListener("pointercancel", () => { box = held = null; draw(); });
    canvas.addEventListener("pointerleave", () => { if (on.hover) on.hover(); });
    canvas.addEventListener("dblclick", () => look(spec.x, spec.y));
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas && !e.ctrlKey) return; // the page scrolls
      e.preventDefault();
      zoom(Math.exp(Math.min(Math.max(e.deltaY, -200), 200) / 400), ...pointer(e));
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey) return;
      if (e.key === "+" || e.key === "=") about(0.6);
      else if (e.key === "-") about(1 / 0.6);
      else if (e.key === "0" || e.key === "Escape") look(spec.x, spec.y);
      else if (e.key in STEPS) on.step(STEPS[e.key] * (e.shiftKey ? 10 : 1));
      else return;
      e.preventDefault();
    });
    reset.disabled = true;
    tell();
    return { element, canvas, draw, placed, look: (x) => look(x, view.y, true) };
  };
})();
