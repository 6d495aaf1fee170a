"use strict";
// Lets the reader go through a load history: a slider, a button that plays, charts and the body, all at one
// sample. Of each playback it reads:
//   unit: what a sample is called; numbers: of the samples in the history, from 1; of: how many it has;
//   clock: column of the time or of the sample's number; first: the sample that is shown first;
//   starts: samples at which the history starts anew;
//   columns: of each its label, its unit and its values, K numbers or null;
//   phases: lists of phases, of each the names, the colours, and of, a digit for each sample;
//   charts: see `chart.js`; told: columns that are told of the present sample;
//   body: see `plane.js` and, where it says "space", `turning.js`; samples of its steps; null for none.
// Pictures that a playback replaces stay for print, and for whoever asks for them.
(function () {
  const LASTS = 10000; // ms that playing takes
  const CALM = 600, STILLS = 20; // ms between as many samples, all that whoever wants little motion is shown

  function rounded(value) {
    return value === null ? "no reading" : String(Number(value.toPrecision(4))).replace("-", "−");
  }

  function play(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const count = data.numbers.length;
    const link = {
      now: Math.min(data.first, count - 1),
      unit: data.unit,
      go,
      step(by) { stop(); go(Math.min(Math.max(link.now + by, 0), count - 1)); },
      zoomed(from, x) {
        for (const chart of charts) if (chart.spec !== from && chart.spec.clock && from.clock) chart.look(x);
      },
      called: (k) => [data.unit + " " + data.numbers[k] + " of " + data.of,
        ...(data.columns[data.clock].unit ? [said(data.clock, k)] : [])].join(", "),
      said,
    };
    function said(column, k) {
      const { label, unit, values } = data.columns[column];
      return label + " " + rounded(values[k]) + (values[k] === null || !unit ? "" : unit === "°" ? unit : " " + unit);
    }
    const charts = data.charts.map((spec) => chartOf(spec, data, link));
    const bodies = data.body === null ? [] : [data.body.space ? inSpace(data.body) : planeOf(data.body, link)];

    function inSpace(body) {
      const made = turningOf(body, link), element = document.createElement("section");
      const title = document.createElement("h3");
      element.className = "frame";
      title.textContent = "Body";
      element.append(title, made.canvas, made.controls);
      return { ...made, element };
    }

    const controls = document.createElement("div"), parts = document.createElement("div");
    const slider = document.createElement("input"), button = document.createElement("button");
    const told = document.createElement("output"), name = document.createElement("label");
    controls.className = "controls";
    parts.className = "parts";
    button.type = "button";
    Object.assign(slider, { type: "range", min: 0, max: count - 1, step: 1, value: link.now });
    slider.id = name.htmlFor = "at-" + document.querySelectorAll(".playback .controls").length;
    name.textContent = data.unit;
    told.setAttribute("aria-live", "off"); // the slider tells the same to screen readers
    controls.append(button, name, slider, told);
    parts.append(...bodies.map((b) => b.element), ...charts.map((c) => c.element));
    figure.querySelector("script").before(controls, parts);

    function go(k) {
      link.now = k;
      slider.value = k;
      const phases = data.phases.map((p) => p.names[p.of.charCodeAt(k) - 48]);
      const words = [link.called(k), ...new Set(phases), ...data.told.map((c) => said(c, k))].join(" · ");
      told.textContent = words;
      slider.setAttribute("aria-valuetext", words);
      for (const body of bodies) body.step(nearest(data.body.samples, data.numbers[k] - 1));
      for (const chart of charts) chart.draw();
    }

    function nearest(samples, wanted) {
      let [low, high] = [0, samples.length - 1];
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (samples[middle] <= wanted) low = middle;
        else high = middle;
      }
      return wanted - samples[low] <= samples[high] - wanted ? low : high;
    }

    let playing = null; // when it began, and at which sample
    function label() {
      button.textContent = playing ? "⏸ Pause" : "▶ Play";
      figure.dataset.playing = Boolean(playing);
    }
    function stop() {
      playing = null;
      label();
    }
    function tick(time) {
      if (!playing) return;
      const began = playing.began ?? (playing.began = time);
      const share = (time - began) / LASTS, calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
      const passed = calm ? Math.floor((time - began) / CALM) / STILLS : share;
      const k = Math.min(playing.from + Math.floor(passed * count), count - 1);
      if (k !== link.now) go(k);
      if (k === count - 1) stop();
      else requestAnimationFrame(tick);
    }
    button.addEventListener("click", () => {
      if (playing) { stop(); return; }
      if (link.now === count - 1) go(0);
      playing = { from: link.now };
      label();
      requestAnimationFrame(tick);
    });
    slider.addEventListener("input", () => { stop(); go(Number(slider.value)); });
    const draw = () => { for (const part of [...bodies, ...charts]) part.draw(); };
    window.addEventListener("resize", draw);
    window.addEventListener("afterprint", draw);
    label();
    document.documentElement.classList.add("played");
    go(link.now);
  }

  // Brings back the pictures that charts stand in for.
  function pictures() {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "pictures";
    const say = () => {
      const shown = document.documentElement.classList.contains("pictured");
      button.textContent = shown ? "Hide the still pictures" : "Show the still pictures";
      button.setAttribute("aria-expanded", shown);
    };
    button.addEventListener("click", () => { document.documentElement.classList.toggle("pictured"); say(); });
    say();
    return button;
  }

  const playbacks = [...document.querySelectorAll(".playback")];
  playbacks.forEach(play);
  if (playbacks.length) playbacks[playbacks.length - 1].append(pictures());
})();
