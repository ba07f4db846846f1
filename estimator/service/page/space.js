// A view in space that can be turned: places with arrows, and the coil's winding or several coils. Orthographic, so that lengths can be compared.

import { svg } from "./vendor/lit-html.js";
import { size } from "./words.js";

const WIDTH = 440;
const HEIGHT = 360;
const TURN = Math.PI / 200; // per pixel
const STEP = Math.PI / 24; // per key
const HEAD = 4.5;
const RING = 64; // points of a coil's outline, none of them on an axis

// The direction of view, shared by figures that are compared.
export class Viewpoint {
  constructor(update) {
    Object.assign(this, { azimuth: -0.9, elevation: 0.35, zoom: 1, update });
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.elevation + elevation));
    this.update();
  }

  // Right and up on the screen, and towards the eye.
  project([x, y, z]) {
    const [ca, sa, ce, se] = [this.azimuth, this.elevation].flatMap((a) => [Math.cos(a), Math.sin(a)]);
    return [y * ca - x * sa, z * ce - (x * ca + y * sa) * se, (x * ca + y * sa) * ce + z * se];
  }
}

// Middle and half-width of everything that a view shows, so that views that are compared share their scale.
export function extentOf(points, winding) {
  const all = [...points];
  if (winding) {
    const r = winding.outer_radius_m;
    all.push([-r, -r, 0], [r, r, 0], [0, 0, -winding.length_m]);
  }
  const low = [0, 1, 2].map((k) => Math.min(...all.map((p) => p[k])));
  const high = [0, 1, 2].map((k) => Math.max(...all.map((p) => p[k])));
  const middle = low.map((v, k) => 0.5 * (v + high[k]));
  return { middle, half: Math.max(1e-6, 0.5 * Math.hypot(...high.map((v, k) => v - low[k]))) };
}

// Field of the longest arrows: nearly the largest of some vectors.
export function arrowScale(vectors) {
  const sizes = vectors.map((v) => Math.hypot(...v)).sort((a, b) => a - b);
  return sizes[Math.floor(0.97 * (sizes.length - 1))] || 1e-9;
}

// The largest round number up to a value.
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((k) => k * power).find((k) => k <= 1.001 * value);
}

/* options: name (for screen readers), points (m), vectors (T), kinds (class of each arrow), winding, rings (of coils, with name and
   points), extent, field (of the longest arrows), view. */
export function space({ name, points, vectors, kinds, winding, rings = [], extent, field, view }) {
  const pixels = (0.54 * Math.min(WIDTH, HEIGHT) * view.zoom) / extent.half;
  const at = (point) => {
    const [right, up, near] = view.project(point.map((v, k) => v - extent.middle[k]));
    return [WIDTH / 2 + right * pixels, HEIGHT / 2 - up * pixels, near];
  };
  const arrow = 0.24 * extent.half; // of the given field
  const shown = nice(field);
  const strokes = {};
  points.forEach((point, i) => {
    const tip = point.map((v, k) => v + (vectors[i][k] / field) * arrow);
    const [from, to] = [at(point), at(tip)];
    const depth = from[2] > 0.2 * extent.half ? "near" : from[2] < -0.2 * extent.half ? "far" : "middle";
    const key = `${kinds[i]} ${depth}`;
    strokes[key] = (strokes[key] ?? "") + arrowPath(from, to);
  });
  const order = ["far", "middle", "near"];
  const keys = Object.keys(strokes).sort((a, b) => order.indexOf(a.split(" ")[1]) - order.indexOf(b.split(" ")[1]));
  const bar = nice(0.5 * extent.half);
  const turn = (event) => {
    if (event.buttons & 1) view.turn(-TURN * event.movementX, TURN * event.movementY);
  };
  const grip = (event) => event.currentTarget.setPointerCapture(event.pointerId);
  return svg`<svg class="space" viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" tabindex="0"
      aria-label="${name}. Arrow keys turn it, plus and minus change its size."
      @pointerdown=${grip} @pointermove=${turn} @keydown=${(event) => onKey(event, view)}>
    ${winding ? windingLines(winding, at) : null}
    ${rings.map((ring) => ringLine(ring, at))}
    ${axes(at, extent)}
    ${keys.map((key) => svg`<path class="arrow ${key}" d=${strokes[key]} />`)}
    <g transform="translate(14 ${HEIGHT - 14})">
      <path class="ruler" d="M0 0h${bar * pixels}m0 -3v6M0 -3v6" />
      <text x="0" y="-7">${Number((1e3 * bar).toPrecision(2))} mm</text>
    </g>
    <g transform="translate(${WIDTH - 14} ${HEIGHT - 14})">
      <path class="arrow strong near" d=${arrowPath([(-arrow * pixels * shown) / field, 0], [0, 0])} />
      <text class="end" x="0" y="-7">${size(shown, "T")}</text>
    </g>
  </svg>`;
}

function onKey(event, view) {
  const turns = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
  const zooms = { "+": 1.2, "=": 1.2, "-": 1 / 1.2 };
  if (event.key in turns) view.turn(...turns[event.key]);
  else if (event.key in zooms) {
    view.zoom = Math.max(0.3, Math.min(6, view.zoom * zooms[event.key]));
    view.update();
  } else return;
  event.preventDefault();
}

function arrowPath([x0, y0], [x1, y1]) {
  const f = (v) => v.toFixed(1);
  const length = Math.hypot(x1 - x0, y1 - y0);
  const dot = `M${f(x0)} ${f(y0)}h.01`;
  if (length < 1) return dot;
  const [dx, dy] = [(x1 - x0) / length, (y1 - y0) / length];
  const head = Math.min(HEAD, 0.45 * length);
  const side = (s) => `M${f(x1)} ${f(y1)}L${f(x1 - head * (dx + s * 0.5 * dy))} ${f(y1 - head * (dy - s * 0.5 * dx))}`;
  return `${dot}M${f(x0)} ${f(y0)}L${f(x1)} ${f(y1)}${side(1)}${side(-1)}`;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// The mean turn of each coil in the frame of one of them: arcs, with straight sides between where there are any.
export function ringsAround(coils, name) {
  const frame = coils.find((coil) => coil.name === name);
  if (!frame) return [];
  const axes = [frame.x_axis, frame.y_axis, cross(frame.x_axis, frame.y_axis)];
  const inFrame = (point) => axes.map((axis) => dot(axis, point.map((v, k) => v - frame.origin_m[k])));
  return coils.map((coil) => {
    const normal = cross(coil.x_axis, coil.y_axis);
    const along = (x, y) => coil.origin_m.map((v, k) => v + x * coil.x_axis[k] + y * coil.y_axis[k] - coil.depth_m * normal[k]);
    const [halfX, halfY] = coil.straight_m.map((v) => v / 2);
    const points = Array.from({ length: RING }, (_, k) => {
      const a = (2 * Math.PI * (k + 0.5)) / RING;
      const [c, s] = [Math.cos(a), Math.sin(a)];
      return inFrame(along(coil.radius_m * c + halfX * Math.sign(c), coil.radius_m * s + halfY * Math.sign(s)));
    });
    return { name: coil.name, points };
  });
}

// A closed line with the name above its highest point.
function ringLine({ name, points }, at) {
  const shown = points.map(at);
  const [x, y] = shown.reduce((a, b) => (b[1] < a[1] ? b : a));
  return svg`<g class="winding ring">
    <path d="M${shown.map(([x0, y0]) => `${x0.toFixed(1)} ${y0.toFixed(1)}`).join("L")}Z" />
    <text class="middle" x=${x} y=${y - 5}>${name}</text>
  </g>`;
}

function windingLines(winding, at) {
  const ring = (radius, z) =>
    "M" +
    Array.from({ length: 49 }, (_, k) => {
      const a = (2 * Math.PI * k) / 48;
      const [x, y] = at([radius * Math.cos(a), radius * Math.sin(a), z]);
      return `${x.toFixed(1)} ${y.toFixed(1)}`;
    }).join("L");
  const { inner_radius_m: inner, outer_radius_m: outer, length_m: length } = winding;
  const [labelX, labelY] = at([0, 0, -length / 2]);
  return svg`<g class="winding">
    <path d=${ring(outer, -length)} /><path d=${ring(outer, 0)} /><path d=${ring(Math.max(inner, 0), 0)} />
    <path d=${ring(Math.max(inner, 0), -length)} />
    <text class="middle" x=${labelX} y=${labelY}>coil</text>
  </g>`;
}

function axes(at, extent) {
  const corner = extent.middle.map((v) => v - 0.62 * extent.half);
  const [x0, y0] = at(corner);
  return ["x", "y", "z"].map((name, k) => {
    const end = corner.map((v, i) => v + (i === k ? 0.2 * extent.half : 0));
    const [x1, y1] = at(end);
    const [tx, ty] = [x1 + 0.25 * (x1 - x0), y1 + 0.25 * (y1 - y0) + 4];
    return svg`<path class="axis" d="M${x0} ${y0}L${x1} ${y1}" /><text class="middle" x=${tx} y=${ty}>${name}</text>`;
  });
}
