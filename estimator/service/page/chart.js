// Flat charts: bars, values with intervals, and lines. Each is one SVG, coloured by the style sheet.

import { svg } from "./vendor/lit-html.js";
import { minus } from "./words.js";

// Round numbers across a range.
export function ticks(low, high, n = 5) {
  const raw = (high - low) / n || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

// Exponents of round numbers across a range of powers of ten.
function logTicks(low, high) {
  const decades = [];
  for (let k = Math.floor(low); k <= high; k++) decades.push(k);
  if (high - low > 3) return decades.filter((k) => k >= low);
  const steps = high - low > 0.7 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 8];
  return decades.flatMap((k) => steps.map((step) => k + Math.log10(step))).filter((t) => t >= low - 1e-9 && t <= high + 1e-9);
}

const number = (value) => minus(Number(value.toPrecision(6)).toString());

function scale([low, high], [from, to]) {
  return (value) => from + ((value - low) / (high - low || 1)) * (to - from);
}

function xAxis(x, domain, y, top, label, middle) {
  return svg`<g>
    ${ticks(...domain, Math.min(6, Math.max(2, Math.round((x(domain[1]) - x(domain[0])) / 60)))).map(
      (t) => svg`<path class="grid" d="M${x(t)} ${top}V${y}" /><text class="middle" x=${x(t)} y=${y + 15}>${number(t)}</text>`,
    )}
    <text class="middle label" x=${middle} y=${y + 33}>${label}</text></g>`;
}

const ROW = 24;

// Width to draw in, so that letters keep their size on narrow screens.
export const fitting = (most) => Math.max(320, Math.min(most, innerWidth - 70));

// Horizontal bars; rows are {label, value, role, note}.
export function bars(name, rows, label, width = fitting(640)) {
  const [left, right, top] = [width < 500 ? 140 : 170, 60, 6];
  const bottom = top + ROW * rows.length;
  const values = rows.map((row) => row.value);
  const domain = [Math.min(0, ...values), Math.max(1, ...values)];
  const x = scale(domain, [left, width - right]);
  return svg`<svg class="chart" viewBox="0 0 ${width} ${bottom + 42}" role="img" aria-label=${name}>
    ${xAxis(x, domain, bottom, top, label, (left + width - right) / 2)}
    ${rows.map((row, i) => {
      const y = top + ROW * i;
      const [from, to] = [x(0), x(row.value)].sort((a, b) => a - b);
      return svg`<g><title>${row.label}: ${row.note}</title>
        <text class="end ${row.role}" x=${left - 8} y=${y + 16}>${row.label}</text>
        <rect class="bar ${row.role}" x=${from} y=${y + 4} width=${Math.max(1, to - from)} height=${ROW - 8} />
        <text x=${Math.max(to, x(0)) + 6} y=${y + 16}>${row.note}</text></g>`;
    })}
    <path class="zero" d="M${x(0)} ${top}V${bottom}" />
  </svg>`;
}

// Pairs of values with intervals; rows are {label, before: [middle, low, high], after, note}, all in one scale.
export function pairs(name, rows, label, width = fitting(900)) {
  const isNarrow = width < 560;
  const [left, right, top, row] = isNarrow ? [95, 14, 22, 48] : [150, 190, 22, 34];
  const bottom = top + row * rows.length;
  const ends = rows.flatMap((r) => [...r.before, ...r.after]);
  const domain = [Math.min(...ends), Math.max(...ends)];
  const x = scale(domain, [left, width - right]);
  const mark = (one, y, kind) => svg`<path class="interval ${kind}" d="M${x(one[1])} ${y}H${x(one[2])}" />
    <circle class="dot ${kind}" cx=${x(one[0])} cy=${y} r="4.5" />`;
  return svg`<svg class="chart" viewBox="0 0 ${width} ${bottom + 42}" role="img" aria-label=${name}>
    ${xAxis(x, domain, bottom, top, label, (left + width - right) / 2)}
    <g><circle class="dot before" cx=${left + 6} cy="10" r="4.5" /><text x=${left + 15} y="14">as described</text>
    <circle class="dot after" cx=${left + 116} cy="10" r="4.5" /><text x=${left + 125} y="14">extended</text></g>
    ${rows.map((r, i) => {
      const y = top + row * i;
      return svg`<g><title>${r.label}: ${r.note}</title>
        <text class="end" x=${left - 8} y=${y + 21}>${r.label}</text>
        ${mark(r.before, y + 11, "before")} ${mark(r.after, y + 23, "after")}
        <text class="small ${isNarrow ? "end" : ""}" x=${isNarrow ? width - right : width - right + 12} y=${y + (isNarrow ? 39 : 21)}>${r.note}</text></g>`;
    })}
    <path class="zero" d="M${x(0)} ${top}V${bottom}" />
  </svg>`;
}

// Values with intervals beside that of a prior; rows are {label, middle, low, high, note}.
export function intervals(name, rows, label, width = fitting(900)) {
  const isNarrow = width < 560;
  const [left, right, top, row] = isNarrow ? [10, 10, 4, 36] : [210, 170, 6, 26];
  const bottom = top + row * rows.length;
  const domain = [Math.min(-PRIOR_90, ...rows.map((r) => r.low)), Math.max(PRIOR_90, ...rows.map((r) => r.high))];
  const x = scale(domain, [left, width - right]);
  return svg`<svg class="chart" viewBox="0 0 ${width} ${bottom + 42}" role="img" aria-label=${name}>
    ${xAxis(x, domain, bottom, top, label, (left + width - right) / 2)}
    ${rows.map((r, i) => {
      const y = top + row * i + (isNarrow ? 26 : 13);
      return svg`<g><title>${r.label}: ${r.note}</title>
        <text class=${isNarrow ? "" : "end"} x=${isNarrow ? left : left - 8} y=${isNarrow ? y - 11 : y + 4}>${r.label}</text>
        <path class="interval prior" d="M${x(-PRIOR_90)} ${y}H${x(PRIOR_90)}" />
        <path class="interval after" d="M${x(r.low)} ${y}H${x(r.high)}" /><circle class="dot after" cx=${x(r.middle)} cy=${y} r="4" />
        <text class="small ${isNarrow ? "end" : ""}" x=${isNarrow ? width - right : width - right + 12} y=${y + (isNarrow ? -11 : 4)}>${r.note}</text></g>`;
    })}
    <path class="zero" d="M${x(0)} ${top}V${bottom}" />
  </svg>`;
}

const PRIOR_90 = 1.645; // standard deviations
const SHADES = 9; // of a map, from pale to dark

// A map of values in rows from below; null where there is none.
export function heat(name, xs, ys, rows, { xLabel, yLabel, label, log = false, width = fitting(540) }) {
  const [left, right, top] = [58, 74, 8];
  const ratio = Math.min(1.3, Math.max(0.45, (ys.at(-1) - ys[0]) / (xs.at(-1) - xs[0])));
  const height = top + (width - left - right) * ratio + 42;
  const bottom = height - 42;
  const known = rows.flat().filter((v) => v !== null && (!log || v > 0)).sort((a, b) => a - b);
  if (!known.length) return svg`<svg class="chart" viewBox="0 0 ${width} 40" role="img" aria-label=${name}></svg>`;
  const map = log ? Math.log10 : (v) => v;
  const [low, high] = [log ? map(known[Math.floor(0.01 * known.length)]) : 0, map(known[Math.floor(0.99 * (known.length - 1))])];
  const shade = (v) => Math.max(0, Math.min(SHADES - 1, Math.floor(((map(v) - low) / (high - low || 1)) * SHADES)));
  const x = scale([xs[0], xs.at(-1)], [left, width - right]);
  const y = scale([ys[0], ys.at(-1)], [bottom, top]);
  const [dx, dy] = [(width - right - left) / (xs.length - 1), (bottom - top) / (ys.length - 1)];
  const cells = Array.from({ length: SHADES }, () => []);
  const clamp = (v, from, to) => Math.max(from, Math.min(to, v));
  rows.forEach((row, i) =>
    row.forEach((v, j) => {
      if (v === null) return;
      const [x0, x1] = [x(xs[j]) - dx / 2, x(xs[j]) + dx / 2 + 0.4].map((a) => clamp(a, left, width - right));
      const [y0, y1] = [y(ys[i]) - dy / 2, y(ys[i]) + dy / 2 + 0.4].map((a) => clamp(a, top, bottom));
      cells[shade(v)].push(`M${x0.toFixed(1)} ${y0.toFixed(1)}H${x1.toFixed(1)}V${y1.toFixed(1)}H${x0.toFixed(1)}Z`);
    }),
  );
  const step = (bottom - top) / SHADES;
  const told = (k) => {
    const value = low + ((high - low) * k) / SHADES;
    return number(Number((log ? 10 ** value : value).toPrecision(2)));
  };
  return svg`<svg class="chart" viewBox="0 0 ${width} ${height}" role="img" aria-label=${name}>
    <rect class="nothing" x=${left} y=${top} width=${width - left - right} height=${bottom - top} />
    ${cells.map((paths, k) => (paths.length ? svg`<path class="shade s${k}" d=${paths.join("")} />` : null))}
    ${xAxis(x, [xs[0], xs.at(-1)], bottom, bottom, xLabel, (left + width - right) / 2)}
    ${ticks(ys[0], ys.at(-1)).map((t) => svg`<text class="end" x=${left - 6} y=${y(t) + 4}>${number(t)}</text>`)}
    <text class="middle label" transform="translate(13 ${(top + bottom) / 2}) rotate(-90)">${yLabel}</text>
    ${cells.map((_, k) => svg`<rect class="shade s${k}" x=${width - right + 10} y=${bottom - (k + 1) * step} width="14" height=${step + 0.4} />`)}
    ${[0, 3, 6, 9].map((k) => svg`<text class="small" x=${width - right + 28} y=${clamp(bottom - k * step + 4, top + 9, bottom)}>${told(k)}</text>`)}
    <text class="small label middle" transform="translate(${width - 4} ${(top + bottom) / 2}) rotate(-90)">${label}</text>
  </svg>`;
}

// A time line: spans of readings, each from where it begins to where it was noticed, and a mark there.
export function strip(name, spans, n, words, width = fitting(900)) {
  const [left, right, middle] = [10, 10, 12];
  const x = scale([1, Math.max(n, 2)], [left, width - right]);
  return svg`<svg class="chart" viewBox="0 0 ${width} 58" role="img" aria-label=${name}>
    <path class="zero" d="M${left} ${middle}H${width - right}" />
    ${spans.map(([since, at], i) => svg`<g><title>${words[i]}</title><path class="interval alarm" d="M${x(since)} ${middle}H${x(at)}" />
      <circle class="dot alarm" cx=${x(at)} cy=${middle} r="4.5" /></g>`)}
    ${ticks(1, Math.max(n, 2), 6).map((t) => svg`<text class="middle" x=${x(t)} y=${middle + 20}>${number(t)}</text>`)}
    <text class="middle label" x=${(left + width - right) / 2} y=${middle + 38}>reading</text>
  </svg>`;
}

// Lines over a common axis; series are {label, kind, points: [[x, y], ...]}; `log` makes the y axis logarithmic.
export function lines(name, series, { xLabel, yLabel, log = false, mark = null, dots = false, width = fitting(540), height = 320 }) {
  const [left, right, top] = [58, dots ? 14 : 96, 10];
  const bottom = height - 42;
  const map = log ? (v) => Math.log10(Math.max(v, 1e-30)) : (v) => v;
  const points = series.flatMap((s) => s.points);
  const xs = points.map((p) => p[0]);
  const ys = points.map((p) => map(p[1])).concat(mark === null ? [] : [0, 2 * mark]);
  const range = (values) => (values.length ? [Math.min(...values), Math.max(...values)] : [0, 1]);
  const [xDomain, yDomain] = [range(xs), range(ys)];
  if (yDomain[1] === yDomain[0]) yDomain[1] += 1;
  const x = scale(xDomain, [left, width - right]);
  const y = scale(yDomain, [bottom, top]);
  const yTicks = log ? logTicks(...yDomain) : ticks(...yDomain);
  return svg`<svg class="chart" viewBox="0 0 ${width} ${height}" role="img" aria-label=${name}>
    ${xAxis(x, xDomain, bottom, top, xLabel, (left + width - right) / 2)}
    ${yTicks.map(
      (t) => svg`<path class="grid" d="M${left} ${y(t)}H${width - right}" />
        <text class="end" x=${left - 6} y=${y(t) + 4}>${number(log ? Number((10 ** t).toPrecision(2)) : t)}</text>`,
    )}
    <text class="middle label" transform="translate(13 ${(top + bottom) / 2}) rotate(-90)">${yLabel}</text>
    ${series.map((s) => {
      const path = s.points.map((p) => `${x(p[0]).toFixed(1)} ${y(map(p[1])).toFixed(1)}`);
      return dots
        ? svg`<path class="points ${s.kind}" d=${path.map((p) => `M${p}h.01`).join("")} />`
        : svg`<path class="line ${s.kind}" d="M${path.join("L")}" />`;
    })}
    ${mark === null ? null : svg`<path class="zero" d="M${left} ${y(mark)}H${width - right}" />`}
    ${labels(series, x, y, map, width - right, [top, bottom])}
  </svg>`;
}

// Names of lines at their ends, moved apart where they would overlap.
function labels(series, x, y, map, right, [top, bottom]) {
  const placed = series
    .filter((s) => s.points.length)
    .map((s) => ({ s, at: y(map(s.points.at(-1)[1])) }))
    .sort((a, b) => a.at - b.at);
  placed.forEach((one, i) => {
    one.at = Math.max(one.at, i ? placed[i - 1].at + 13 : top + 8);
  });
  for (let i = placed.length - 1, most = bottom; i >= 0; i--, most -= 13) placed[i].at = Math.min(placed[i].at, most);
  return placed.map(({ s, at }) => svg`<text class="small ${s.kind}-text" x=${right + 6} y=${at + 4}>${s.label}</text>`);
}
