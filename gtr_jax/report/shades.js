"use strict";
// How pictures of bodies show tension and size: colours from no tension to the largest, their key, and a bar of
// a round number of millimetres.
const shades = (function () {
  const COLOURS = [[253, 231, 37], [94, 201, 98], [33, 145, 140], [59, 82, 139], [68, 1, 84]];
  const INK = "#222";

  function colour(share) {
    const at = Math.min(Math.max(share, 0), 1) * (COLOURS.length - 1);
    const i = Math.min(Math.floor(at), COLOURS.length - 2);
    const mixed = COLOURS[i].map((c, k) => Math.round(c + (at - i) * (COLOURS[i + 1][k] - c)));
    return "rgb(" + mixed.join(",") + ")";
  }

  // The key of the colours, which ends at `right` and begins at `top`.
  function key(pen, right, top, most) {
    for (let i = 0; i < 100; i++) {
      pen.fillStyle = colour(i / 99);
      pen.fillRect(right - 100 + i, top, 1.5, 8);
    }
    pen.fillStyle = INK;
    pen.textAlign = "right";
    pen.fillText("tension 0 to " + most + " N", right, top + 22);
    pen.textAlign = "left";
  }

  // A bar that ends at `right` and stands at `bottom`; `scale` is in pixels per mm.
  function bar(pen, right, bottom, scale) {
    const wanted = 120 / scale, power = Math.pow(10, Math.floor(Math.log10(wanted)));
    const length = [1, 2, 5].map((m) => m * power).filter((l) => l <= wanted).pop();
    pen.fillStyle = INK;
    pen.fillRect(right - length * scale, bottom, length * scale, 3);
    pen.textAlign = "right";
    pen.fillText(length + " mm", right, bottom - 8);
    pen.textAlign = "left";
  }

  return { colour, key, bar };
})();
