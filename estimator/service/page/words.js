// Numbers, names and times as people read them.

import { html } from "./vendor/lit-html.js";

const SHOWN = { m: [1e3, "mm"], rad: [1e3, "mrad"], T: [1e6, "µT"], A: [1, "A"], s: [1, "s"], 1: [1, ""] };
const NOTHING = 1e-13; // in SI; what is left of a calculation that gives zero
const PREFIXES = [
  [1, ""],
  [1e-3, "m"],
  [1e-6, "µ"],
  [1e-9, "n"],
];

// Factor and unit in which a quantity of an SI unit is shown.
export function shownIn(unit) {
  const [head, ...rest] = unit.split("/");
  const [factor, symbol] = SHOWN[head] ?? [1, head];
  return { factor, unit: rest.length ? `${symbol || "1"}/${rest.join("/")}` : symbol };
}

// A number to the second digit of its standard deviation.
export function rounded(value, sd) {
  if (!Number.isFinite(value)) return "not known";
  if (!(sd > 0)) return minus(Number(value.toPrecision(6)).toString());
  const digits = Math.max(0, 1 - Math.floor(Math.log10(Number(sd.toPrecision(2)))));
  return fixed(value, Math.min(digits, 12));
}

// A number with so many decimals; what rounds to zero is zero without a sign.
export const fixed = (value, decimals) => minus((Math.round(value * 10 ** decimals) / 10 ** decimals + 0).toFixed(decimals));

export const minus = (text) => text.replace("-", "−");

// A size in the unit of its order, as `12 µT`.
export function size(value, unit, digits = 2) {
  const head = unit.split("/")[0];
  if (Math.abs(value) < NOTHING) return unit === "1" ? "0" : `0 ${unit}`;
  if (!["T", "m", "rad", "A"].includes(head)) {
    return unit === "1" && Math.abs(value) < 1 && value !== 0
      ? `${minus(Number((100 * value).toPrecision(digits)).toString())} %`
      : `${minus(Number(value.toPrecision(digits)).toString())}${unit === "1" ? "" : ` ${unit}`}`;
  }
  const [factor, prefix] = PREFIXES.find(([least]) => Math.abs(value) >= least) ?? PREFIXES.at(-1);
  return `${minus(Number((value / factor).toPrecision(digits)).toString())} ${prefix}${unit}`;
}

export function percent(share) {
  if (share > 0.995) return "over 99 %";
  if (share < 0.005) return "under 1 %";
  return `${Math.round(100 * share)} %`;
}

const STEPS = [
  [60, "second"],
  [60, "minute"],
  [24, "hour"],
  [30, "day"],
  [12, "month"],
  [Infinity, "year"],
];

export function age(iso) {
  let passed = (Date.now() - new Date(iso).getTime()) / 1000;
  const words = new Intl.RelativeTimeFormat("en", { numeric: "auto" });
  for (const [length, name] of STEPS) {
    if (Math.abs(passed) < length) return words.format(-Math.round(passed), name);
    passed /= length;
  }
  return iso;
}

export const when = (iso) => new Date(iso).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
// A name that may be broken where its words are joined.
export const breakable = (name) => name.split("_").flatMap((word, i) => (i ? ["_", html`<wbr />`, word] : [word]));

export const short = (id) => id?.slice(0, 8) ?? "";

const JOBS = { calibrate: "Calibration", diagnose: "Diagnosis", recalibrate: "Recalibration", batch: "Batch", design: "Design" };
export const jobName = (kind) => JOBS[kind] ?? kind;
