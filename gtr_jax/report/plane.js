"use strict";
// A body in the plane, at one step after the other. It reads of `body`:
//   scale: mm of one unit of "place"; most: largest tension [N]; radius: of the body [mm], M values;
//   offsets: of each channel from the midline [mm], M values; ends: how many of the M places each tendon reaches;
//   steps: place (x, y at M places), angle of the midline (in 1/10000 rad, at M places), tension of each tendon
//   at M places, in thousandths of "most"; markers: places of markers, as "place".
// The first step stands in grey behind the others.
const planeOf = (function () {
  const INK = "#222", GREY = "#999", FILL = "rgba(34,34,34,0.07)", MARKER = "#d55e00";

  function built(body, step) {
    const pairs = (flat) => {
      const out = [];
      for (let i = 0; i < flat.length; i += 2) out.push([body.scale * flat[i], body.scale * flat[i + 1]]);
      return out;
    };
    const middle = pairs(step.place);
    const beside = (offsets, side) => middle.map(([x, y], i) => {
      const angle = 1e-4 * step.angle[i], out = side * offsets[i];
      return [x - out * Math.sin(angle), y + out * Math.cos(angle)];
    });
    const outline = [...beside(body.radius, 1), ...beside(body.radius, -1).reverse()];
    const channels = body.offsets.map((own) => beside(own, 1));
    return { middle, outline, channels, tension: step.tension, markers: pairs(step.markers) };
  }

  function path(pen, place, points, closed) {
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(place.x(x), place.y(y)) : pen.moveTo(place.x(x), place.y(y))));
    if (closed) pen.closePath();
  }

  return function (body, link) {
    const steps = body.steps.map((step) => built(body, step));
    let shown = 0;
    const places = steps.flatMap((step) => [...step.outline, ...step.markers]);
    const range = (i) => {
      const all = places.map((p) => p[i]), low = Math.min(...all), high = Math.max(...all);
      return [low - 0.05 * (high - low), high + 0.05 * (high - low)];
    };
    const frame = frameOf({
      title: "Body", across: "x [mm]", up: "y [mm]", equal: true, above: 30, x: range(0), y: range(1),
      says: "The body in its plane with its channels, coloured by the tension of the tendon.",
    }, { paint, head, step: link.step });
    const key = document.createElement("p");
    key.className = "key";
    key.textContent = "Grey: at the first " + link.unit + ". Channels are coloured by the tension in them.";
    frame.element.append(key);

    function paint(pen, place) {
      outline(pen, place, steps[0], GREY);
      const step = steps[shown];
      outline(pen, place, step, INK);
      pen.lineWidth = 3;
      pen.lineCap = "round";
      step.channels.forEach((channel, n) => {
        for (let i = 0; i + 1 < body.ends[n]; i++) {
          pen.strokeStyle = shades.colour((step.tension[n][i] + step.tension[n][i + 1]) / 2000);
          path(pen, place, [channel[i], channel[i + 1]], false);
          pen.stroke();
        }
      });
      pen.fillStyle = MARKER;
      for (const [x, y] of step.markers) pen.fillRect(place.x(x) - 3, place.y(y) - 3, 6, 6);
    }

    function head(pen, place) {
      shades.key(pen, place.right, 2, body.most);
    }

    function outline(pen, place, step, colour) {
      pen.strokeStyle = colour;
      pen.fillStyle = FILL;
      pen.lineWidth = 1.2;
      path(pen, place, step.outline, true);
      pen.fill();
      pen.stroke();
      pen.setLineDash([7, 2, 1, 2]);
      path(pen, place, step.middle, false);
      pen.stroke();
      pen.setLineDash([]);
    }

    return { element: frame.element, draw: frame.draw, step(k) { shown = k; frame.canvas.dataset.step = k; frame.draw(); } };
  };
})();
