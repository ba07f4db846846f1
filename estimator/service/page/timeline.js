// A registry over time in one SVG: conclusions on top; below, a panel for each parameter with the versions in use as bands and the
// sessions as points with their intervals.

import { svg } from "./vendor/lit-html.js";
import { ticks } from "./chart.js";
import { minus, shownIn } from "./words.js";

const HALF_WIDTH_90 = 1.645;
const STRIP = 62;
const PANEL = 92;
const [LEFT, RIGHT] = [66, 34];
const HOUR = 3_600_000;
const DAY = 24 * HOUR;
const STEPS = [HOUR, 6 * HOUR, DAY, 2 * DAY, 7 * DAY, 14 * DAY]; // then months
const MONTHS = [1, 2, 3, 6, 12, 24, 60];

const MARKS = {
  unchanged: "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
  updated: "M-4 -4h8v8h-8z",
  drifted: "M0 -5.5L5.5 0L0 5.5L-5.5 0z",
  rejected: "M-4 -4L4 4M-4 4L4 -4",
};

export const utc = (time) => new Date(time).toISOString().slice(0, 16).replace("T", " ");

// Instants of round dates, in UTC, and how to write them.
function timeTicks(low, high, most) {
  const step = STEPS.find((one) => (high - low) / one <= most);
  if (step) {
    const first = Math.ceil(low / step) * step;
    const instants = Array.from({ length: Math.floor((high - first) / step) + 1 }, (_, i) => first + i * step);
    return instants.map((t) => [t, step < DAY ? utc(t).slice(5) : utc(t).slice(5, 10)]);
  }
  const months = MONTHS.find((n) => (high - low) / (30.4 * DAY * n) <= most) ?? 120;
  const begin = new Date(low);
  const found = [];
  for (let k = Math.floor(begin.getUTCMonth() / months) * months; ; k += months) {
    const t = Date.UTC(begin.getUTCFullYear(), k, 1);
    if (t > high) return found;
    if (t >= low) found.push([t, utc(t).slice(0, months % 12 ? 7 : 4)]);
  }
}

/* history: of the service, with times as numbers; names: of the parameters that are drawn. */
export function timeline(name, { sessions, periods, units }, names, width) {
  const [begin, end] = [Math.min(...sessions.map((one) => one.time), ...periods.map((one) => one.begin)), periods.at(-1)?.end ?? sessions.at(-1).time + HOUR];
  const margin = 0.02 * (end - begin) || HOUR;
  const x = (time) => LEFT + ((time - begin + margin) / (end - begin + margin)) * (width - LEFT - RIGHT);
  const bottom = STRIP + PANEL * names.length;
  return svg`<svg class="chart timeline" viewBox="0 0 ${width} ${bottom + 40}" role="img" aria-label=${name}>
    ${timeTicks(begin - margin, end, Math.max(2, Math.floor((width - LEFT - RIGHT) / 90))).map(
      ([t, words]) => svg`<path class="grid" d="M${x(t)} ${STRIP - 8}V${bottom}" /><text class="middle" x=${x(t)} y=${bottom + 15}>${words}</text>`,
    )}
    <text class="middle label" x=${(LEFT + width - RIGHT) / 2} y=${bottom + 33}>time of the readings (UTC)</text>
    ${periods.slice(1).map((one) => svg`<path class="change" d="M${x(one.begin)} ${STRIP - 22}V${bottom}" />`)}
    ${names.map((one, i) => panel(one, units[one], STRIP + PANEL * i, { sessions, periods, x, width }))}
    <text class="end small" x=${LEFT - 8} y="18">sessions</text>
    ${sessions.map((one) => svg`<g><title>${utc(one.time)}: ${one.conclusion}${one.cause ? `, ${one.cause}` : ""}</title>${mark(one, x(one.time), 14)}</g>`)}
    ${spaced(sessions.filter((one) => one.cause), x).map((one) => svg`<text class="small middle" x=${Math.min(Math.max(x(one.time), LEFT), width - 60)} y="33">${one.cause}</text>`)}
    ${spaced(periods.map((one) => ({ ...one, time: one.begin })), x, 60).map((one) => svg`<text class="small" x=${Math.min(x(one.begin) + 4, width - 62)} y=${STRIP - 12}>version ${one.version}</text>`)}
  </svg>`;
}

// Those of some labels that do not overlap the one before.
function spaced(labels, x, least = 110) {
  let last = -Infinity;
  return labels.filter((one) => {
    if (x(one.time) - last < least) return false;
    last = x(one.time);
    return true;
  });
}

const mark = (session, x, y) => svg`<path class="mark ${session.conclusion}" transform="translate(${x} ${y})" d=${MARKS[session.conclusion]} />`;

function panel(name, siUnit, top, { sessions, periods, x, width }) {
  const { factor, unit } = shownIn(siUnit);
  const bands = periods.filter((one) => one.intervals[name]).map((one) => ({ ...one, ends: one.intervals[name].map((v) => v * factor) }));
  const points = sessions.filter((one) => one.estimate[name]).map((one) => {
    const [value, sd] = one.estimate[name].map((v) => v * factor);
    return { ...one, value, half: HALF_WIDTH_90 * sd };
  });
  const all = [...bands.flatMap((one) => one.ends), ...points.flatMap((one) => [one.value - one.half, one.value + one.half])];
  const [low, high] = [Math.min(...all), Math.max(...all)];
  const [from, to] = [top + PANEL - 10, top + 22];
  const y = (value) => from + ((value - low) / (high - low || 1)) * (to - from);
  const steps = ticks(low, high, 4);
  const digits = Math.max(0, -Math.floor(Math.log10(steps.length > 1 ? steps[1] - steps[0] : 1) + 1e-9));
  return svg`<g>
    ${steps.map((t) => svg`<path class="grid" d="M${LEFT} ${y(t)}H${width - RIGHT}" /><text class="end small" x=${LEFT - 6} y=${y(t) + 4}>${minus(t.toFixed(Math.min(digits, 9)))}</text>`)}
    <text class="named" x=${LEFT} y=${top + 13}>${name}${unit ? ` in ${unit}` : ""}</text>
    ${bands.map((one) => svg`<g><title>version ${one.version}</title>
      <rect class="band" x=${x(one.begin)} y=${y(one.ends[2])} width=${Math.max(1, x(one.end) - x(one.begin))} height=${Math.max(1, y(one.ends[0]) - y(one.ends[2]))} />
      <path class="median" d="M${x(one.begin)} ${y(one.ends[1])}H${x(one.end)}" /></g>`)}
    ${points.map((one) => svg`<path class="spread" d="M${x(one.time)} ${y(one.value - one.half)}V${y(one.value + one.half)}" />${mark(one, x(one.time), y(one.value))}`)}
  </g>`;
}

// What the marks of the figure mean; `present` are the conclusions that it shows.
export function legend(present) {
  const width = 20;
  const shown = Object.keys(MARKS).filter((one) => present.has(one));
  return shown.map((one) => ({ words: one, drawing: svg`<svg class="key" viewBox="0 0 ${width} 16" aria-hidden="true">${mark({ conclusion: one }, 10, 8)}</svg>` }));
}
