"use strict";
// A chart of a playback: lines and dots over one quantity, the present sample, and the values of the sample
// under the mouse. Of `spec` it reads what `frame.js` does but for the ranges, and:
//   lines: of each x and y, numbers of columns; colour; style, "line", "dashed", "dots" or "crosses"; phases, the
//   number of a list of phases whose colours it takes, if any; band, the column of half the height of a band about it, if any;
//   noise: standard deviation, of which two lie in a band about zero, if any; clock: whether x only grows;
//   spans: stretches across, from start to end, with a label, a colour and a mark that stands above.
// `data` is that of the playback, see `playback.js`; `link` is how its parts speak to one another.
const chartOf = (function () {
  const RING = "#111", PALE = "#dddddd", CORNER = 14, ARM = 6;

  function range(every) {
    let [low, high] = [Infinity, -Infinity];
    for (const values of every) for (const v of values)
      if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
    if (low > high) return [0, 1];
    const more = 0.04 * (high - low) || Math.abs(high) * 0.1 || 1;
    return [low - more, high + more];
  }

  return function (spec, data, link) {
    const values = (column) => data.columns[column].values;
    const lines = spec.lines.map((line) => ({ ...line, x: values(line.x), y: values(line.y) }));
    const y = range([...lines.map((line) => line.y), spec.noise ? [-2.2 * spec.noise, 2.2 * spec.noise] : []]);
    const hint = document.createElement("div");
    hint.className = "hint";
    hint.hidden = true;
    const dotted = lines.some((line) => line.style === "dots");
    const starts = new Set(data.starts); // no line leads to them
    let under = null; // the sample under the mouse
    const frame = frameOf({ ...spec, x: range(lines.map((line) => line.x)), y }, {
      paint,
      pick: (px, py) => { const k = nearest(px, py); if (k !== null) link.go(k); },
      hover,
      step: link.step,
      zoomed: (x) => link.zoomed(spec, x),
    });
    frame.element.append(key(), hint);

    function colourOf(line, k) {
      if (line.phases === null) return line.colour;
      return data.phases[line.phases].colours[data.phases[line.phases].of.charCodeAt(k) - 48];
    }

    function paint(pen, place) {
      for (const span of spec.spans) {
        const from = place.x(span.start), wide = Math.max(place.x(span.end) - from, 1);
        pen.fillStyle = span.colour;
        pen.globalAlpha = 0.25;
        pen.fillRect(from, place.top, wide, place.bottom - place.top);
        pen.globalAlpha = 1;
        pen.fillStyle = RING;
        pen.fillText(span.mark, from + 2, place.top + 12);
      }
      for (const line of lines) if (line.band !== null) band(pen, place, line);
      if (spec.noise) {
        pen.fillStyle = PALE;
        const top = place.y(2 * spec.noise);
        pen.fillRect(place.left, top, place.right - place.left, place.y(-2 * spec.noise) - top);
      }
      const styles = { dots, crosses };
      for (const line of lines) (styles[line.style] || stroke)(pen, place, line);
      if (spec.clock) {
        const at = place.x(lines[0].x[link.now]);
        pen.strokeStyle = RING;
        pen.lineWidth = 1;
        pen.beginPath();
        pen.moveTo(at, place.top);
        pen.lineTo(at, place.bottom);
        pen.stroke();
      }
      if (under !== null && under !== link.now) ring(pen, place, under, 4, 1);
      ring(pen, place, link.now, 5.5, 2);
    }

    function band(pen, place, line) {
      const half = values(line.band);
      pen.fillStyle = pen.strokeStyle = PALE;
      pen.lineWidth = 0.5;
      for (let k = 1; k < line.x.length; k++) {
        if ([line.x[k], line.y[k], line.x[k - 1], line.y[k - 1]].includes(null)) continue;
        pen.beginPath();
        pen.moveTo(place.x(line.x[k - 1]), place.y(line.y[k - 1] - half[k - 1]));
        pen.lineTo(place.x(line.x[k]), place.y(line.y[k] - half[k]));
        pen.lineTo(place.x(line.x[k]), place.y(line.y[k] + half[k]));
        pen.lineTo(place.x(line.x[k - 1]), place.y(line.y[k - 1] + half[k - 1]));
        pen.closePath();
        pen.fill();
        pen.stroke();
      }
    }

    function dots(pen, place, line) {
      for (let k = 0; k < line.x.length; k++) {
        if (line.x[k] === null || line.y[k] === null) continue;
        pen.fillStyle = colourOf(line, k);
        pen.globalAlpha = 0.65;
        pen.fillRect(place.x(line.x[k]) - 2, place.y(line.y[k]) - 2, 4, 4);
      }
      pen.globalAlpha = 1;
    }

    function crosses(pen, place, line) {
      pen.lineWidth = 2;
      pen.setLineDash([]);
      for (let k = 0; k < line.x.length; k++) {
        if (line.x[k] === null || line.y[k] === null) continue;
        const [x, y] = [place.x(line.x[k]), place.y(line.y[k])];
        pen.strokeStyle = colourOf(line, k);
        pen.beginPath();
        pen.moveTo(x - ARM, y);
        pen.lineTo(x + ARM, y);
        pen.moveTo(x, y - ARM);
        pen.lineTo(x, y + ARM);
        pen.stroke();
      }
    }

    function stroke(pen, place, line) {
      pen.lineWidth = line.style === "dashed" || dotted ? 1.1 : 1.6; // thin over dots
      pen.lineJoin = "round";
      pen.setLineDash(line.style === "dashed" ? [5, 4] : []);
      let last = null; // colour of the path under the pen
      for (let k = 0; k < line.x.length; k++) {
        if (line.x[k] === null || line.y[k] === null) { if (last) pen.stroke(); last = null; continue; }
        if (starts.has(k)) { if (last) pen.stroke(); last = null; }
        const at = [place.x(line.x[k]), place.y(line.y[k])], colour = colourOf(line, k);
        if (colour !== last) {
          if (last) pen.stroke();
          pen.beginPath();
          if (last && k && line.y[k - 1] !== null) pen.moveTo(place.x(line.x[k - 1]), place.y(line.y[k - 1]));
          else pen.moveTo(...at);
          pen.strokeStyle = last = colour;
        }
        pen.lineTo(...at);
      }
      if (last) pen.stroke();
      pen.setLineDash([]);
    }

    function ring(pen, place, k, size, wide) {
      for (const line of lines) {
        if (line.style === "crosses" || line.x[k] === null || line.y[k] === null) continue;
        pen.beginPath();
        pen.arc(place.x(line.x[k]), place.y(line.y[k]), size, 0, 2 * Math.PI);
        pen.fillStyle = colourOf(line, k);
        pen.fill();
        pen.strokeStyle = RING;
        pen.lineWidth = wide;
        pen.stroke();
      }
    }

    // The sample nearest to a place in pixels; over a clock, nearest along it.
    function nearest(px, py) {
      const place = frame.placed();
      let [found, least] = [null, Infinity];
      for (const line of lines) for (let k = 0; k < line.x.length; k++) {
        if (line.x[k] === null || line.y[k] === null) continue;
        const across = place.x(line.x[k]) - px, up = spec.clock ? 0 : place.y(line.y[k]) - py;
        const far = across * across + up * up;
        if (far < least) [found, least] = [k, far];
      }
      return found;
    }

    function hover(px, py) {
      const place = frame.placed();
      const inside = px >= place.left && px <= place.right && py >= place.top && py <= place.bottom;
      under = inside ? nearest(px, py) : null;
      hint.hidden = under === null;
      if (under !== null) {
        hint.replaceChildren(...told().map((text) => {
          const row = document.createElement("div");
          row.textContent = text;
          return row;
        }));
        const right = px > frame.canvas.clientWidth / 2;
        hint.style.left = right ? "" : frame.canvas.offsetLeft + px + CORNER + "px";
        hint.style.right = right ? frame.element.clientWidth - frame.canvas.offsetLeft - px + CORNER + "px" : "";
        hint.style.top = frame.canvas.offsetTop + py + CORNER + "px";
      }
      frame.draw();
    }

    function told() {
      const columns = new Set(spec.lines.flatMap((line) => [line.x, line.y]));
      return [link.called(under), ...[...columns].filter((c) => c !== data.clock).map((c) => link.said(c, under))];
    }

    // What the lines are, under the chart.
    function key() {
      const list = document.createElement("ul");
      list.className = "key";
      const entries = [];
      for (const line of spec.lines) {
        const label = data.columns[line.y].label;
        if (line.phases === null) entries.push([line.colour, line.style, label]);
        else entries.push(["", line.style, label + ", by phase:"], ...data.phases[line.phases].names.map((name, i) =>
          [data.phases[line.phases].colours[i], line.style, name]));
      }
      for (const line of spec.lines) if (line.band !== null) entries.push([PALE, "band", data.columns[line.band].label]);
      for (const span of spec.spans) entries.push([span.colour, "band faint", span.label]);
      if (spec.noise) entries.push([PALE, "band", "noise, ±2 sd"]);
      for (const [colour, style, text] of new Map(entries.map((e) => [e.join("|"), e])).values()) {
        const item = document.createElement("li"), mark = document.createElement("span");
        mark.className = "mark " + style;
        mark.style.color = colour || "#222";
        item.append(mark, text);
        list.append(item);
      }
      return list;
    }

    return { element: frame.element, draw: frame.draw, spec, look: frame.look };
  };
})();
