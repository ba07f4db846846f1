// An open session while it is measured: places and residuals, intervals that shrink, and alarms.

import { html } from "./vendor/lit-html.js";
import { get } from "./api.js";
import { lines, strip } from "./chart.js";
import { figure } from "./figure.js";
import { arrowScale, extentOf, ringsAround, space, Viewpoint } from "./space.js";
import { breakable, fixed, minus, rounded, short, shownIn, size } from "./words.js";

const STRONG_SIGMA = 3;
const MOST_LINES = 6;
const [LEAST_SILENCE_S, SILENT_PACES, LOOK_EVERY_MS] = [30, 10, 5000];

export class LiveView {
  state = null;
  places = [];
  history = [];

  constructor(update, id) {
    Object.assign(this, { update, id, title: `session ${short(id)}`, view: new Viewpoint(update) });
  }

  async load() {
    this.session = await get(`/v1/sessions/${this.id}`);
    this.rig = await get(`/v1/rigs/${this.session.rig_id}`);
    this.update();
    if (this.session.state !== "open") return;
    this.events = new EventSource(`/v1/sessions/${this.id}/live`);
    this.events.addEventListener("estimate", (event) => this.take(event));
    this.events.addEventListener("end", (event) => {
      this.close();
      this.take(event);
    });
    this.looking = setInterval(this.update, LOOK_EVERY_MS); // readings that stay away make no event
    this.events.onerror = () => {
      this.isLost = true;
      this.update();
    };
  }

  close() {
    clearInterval(this.looking);
    this.events?.close();
  }

  take(event) {
    const news = JSON.parse(event.data);
    this.isLost = false;
    this.heardAt = performance.now();
    this.places = news.is_redrawn ? news.places : [...this.places, ...news.places];
    this.history = news.is_redrawn ? news.history : [...this.history, ...news.history];
    this.state = news;
    this.update();
  }

  template() {
    const { state, session } = this;
    if (!session) return html`<p class="waiting">Loading</p>`;
    const isOpen = session.state === "open" && !state?.has_ended;
    return html`<h1>${this.rig?.name}: ${isOpen ? "being measured" : "closed"}</h1>
      <p class="muted">session ${short(this.id)}, ${session.source.slice(0, 80)}</p>
      ${state?.fault ? html`<p class="fault" role="alert">${state.fault}</p>` : null}
      ${this.isLost ? html`<p class="fault" role="status">The connection is lost; the page tries again.</p>` : null}
      ${isOpen ? null : html`<p>Nothing follows. <a href="#/sessions">Calibrate or diagnose it.</a></p>`}
      ${state ? this.panels(state) : isOpen ? html`<p class="waiting">Waiting for readings</p>` : null}`;
  }

  panels(state) {
    const last = this.places.at(-1);
    return html`<dl class="tiles" aria-live="off">
        ${tile("Readings", state.n_appended, `${state.n_readings} in the estimate`)}
        ${tile("Last residual", last ? `${last.rms_sigma.toFixed(1)} σ` : "none yet", last ? `reading ${last.number}, ${last.sensor}` : "")}
        ${tile("Running diagnosis", ...verdict(state))}
        ${tile("Alarms", state.alarms.length || "none", state.alarms.at(-1) ?? "")}
      </dl>
      <div role="status" class="alarms">${alarms(state)}</div>
      ${silence(state, this.heardAt)}
      ${this.places.length ? html`<div class="figures two even">${this.map()} ${this.widths()}</div>` : null}
      ${this.places.length ? html`<div class="figures two even">${this.residuals()} ${this.table(state)}</div>` : null}
      ${state.devices.length ? this.devices(state.devices) : null}`;
  }

  devices(devices) {
    return html`<div class="card scroll" tabindex="0" role="region" aria-label="Devices">
      <h3>Devices</h3>
      <p class="muted">As the readings tell of them.</p>
      <table>
        <thead><tr><th>device</th><th class="num">last shown</th><th class="num">readings</th><th>state</th></tr></thead>
        <tbody>
          ${devices.map((one) => html`<tr><th scope="row">${DEVICES[one.kind]} ${breakable(one.name)}</th><td class="num long">${shown(one)}</td>
            <td class="num">${one.n_readings}</td><td>${deviceState(one)}</td></tr>`)}
        </tbody>
      </table>
    </div>`;
  }

  map() {
    const coils = [...new Set(this.places.map((one) => one.coil))];
    const coil = coils.includes(this.coil) ? this.coil : coils[0];
    const here = this.places.filter((one) => one.coil === coil);
    const points = here.map((one) => one.position_m);
    const isField = this.arrows === "field";
    const vectors = here.map((one) => (isField ? one.field_T : one.residual_T));
    const field = arrowScale(vectors);
    const rings = ringsAround(this.state.coils, coil);
    const extent = extentOf([...points, ...rings.flatMap((ring) => ring.points)]);
    const last = this.places.at(-1);
    const kinds = here.map((one) => (one === last ? "last" : isField || one.rms_sigma > STRONG_SIGMA ? "strong" : "weak"));
    const choice = coils.length < 2 ? null
      : html`<label>around <select @change=${(e) => { this.coil = e.target.value; this.update(); }}>
          ${coils.map((name) => html`<option ?selected=${name === coil}>${name}</option>`)}</select></label>`;
    const arrows = html`<label>Arrows <select @change=${(e) => { this.arrows = e.target.value; this.update(); }}>
      <option value="residual">what the estimate leaves</option><option value="field">the field</option></select></label>`;
    const caption = isField ? "Measured field" : "Measured less predicted field, in colour over three standard deviations,";
    return figure(
      "places", "Places taken",
      html`${caption} in the frame of ${coil}; the newest reading thick, and the coils as they stood then. ${arrows} ${choice}`,
      space({ name: isField ? "Places and field" : "Places and residuals", points, vectors, kinds, winding: null, rings, extent, field, view: this.view }),
      () => [["number", "coil", "x_m", "y_m", "z_m", "Bx_T", "By_T", "Bz_T", "residual_x_T", "residual_y_T", "residual_z_T", "rms_sigma"],
        ...this.places.map((one) => [one.number, one.coil, ...one.position_m, ...one.field_T, ...one.residual_T, one.rms_sigma])],
    );
  }

  widths() {
    const names = Object.keys(this.history.at(-1)?.sd ?? {}).slice(0, MOST_LINES);
    const first = Object.fromEntries(names.map((name) => [name, this.history[0].sd[name]]));
    const series = names.map((name, i) => ({
      label: shortName(name), kind: `c${i}`,
      points: this.history.map((one) => [one.n_readings, (100 * one.sd[name]) / first[name]]),
    }));
    return figure(
      "widths", "Intervals shrink", "Standard deviation of each parameter, relative to the first estimate.",
      lines("Widths of the credible intervals", series, { xLabel: "readings in the estimate", yLabel: "% of the first", log: true }),
      () => [["n_readings", ...Object.keys(this.history.at(-1).sd)], ...this.history.map((one) => [one.n_readings, ...Object.values(one.sd)])],
    );
  }

  residuals() {
    const points = this.places.map((one) => [one.number, one.rms_sigma]);
    return figure(
      "residuals", "Residual of each reading", "Root mean square of its components in units of the noise; about 1 while the model holds.",
      lines("Residuals", [{ label: "", kind: "c0", points }], { xLabel: "reading", yLabel: "σ", mark: 1, dots: true }),
      () => [["number", "rms_sigma"], ...points],
    );
  }

  table(state) {
    return html`<div class="card scroll" tabindex="0" role="region" aria-label="Estimate">
      <h3>Estimate</h3>
      <p class="muted" role="status">${standing(state)}</p>
      <table>
        <thead><tr><th>parameter</th><th class="num">value ± sd</th><th class="num">90 % interval</th><th>unit</th></tr></thead>
        <tbody>
          ${Object.entries(state.intervals).map(([name, one]) => {
            const { factor, unit } = shownIn(one.unit);
            const [value, sd, low, high] = [one.value, one.sd, one.low, one.high].map((v) => v * factor);
            return html`<tr><th scope="row">${breakable(name)}</th><td class="num">${rounded(value, sd)} ± ${rounded(sd, sd)}</td>
              <td class="num">${rounded(low, sd)} to ${rounded(high, sd)}</td><td>${unit}</td></tr>`;
          })}
        </tbody>
      </table>
    </div>`;
  }
}

// Alarms in one line and along the session; all of them where somebody asks.
function alarms({ alarms: all, alarm_readings: readings, n_appended: n }) {
  if (!all.length) return null;
  const marks = strip("Alarms along the session", readings, n, all);
  if (all.length === 1) return html`<div class="warn card"><p>${all[0]}</p>${marks}</div>`;
  return html`<div class="warn card"><details><summary>${all.length} alarms; the last: ${all.at(-1)}</summary>
    <ol>${all.map((words) => html`<li>${words}</li>`)}</ol></details>${marks}</div>`;
}

// That readings have stopped to come, where they came often before.
function silence({ silent_s: silent, pace_s: pace, has_ended: hasEnded }, heardAt) {
  if (hasEnded || silent === null || pace === null) return null;
  const passed = silent + (performance.now() - heardAt) / 1000;
  if (passed < Math.max(LEAST_SILENCE_S, SILENT_PACES * pace)) return null;
  const told = passed < 120 ? `${Math.round(passed)} seconds` : `${Math.round(passed / 60)} minutes`;
  return html`<p class="fault" role="alert">No reading for ${told}; before, one came every ${pace.toPrecision(2)} s. The measuring process has ended or hangs: look at
    its terminal. The same command goes on where it stopped; close the session if nothing is to follow.</p>`;
}

const shortName = (name) => name.split(".").at(-1).replace(/_(m|rad|T|A)$/, "").replaceAll("_", " ");

const DEVICES = { sensor: "sensor", mover: "mover", supply: "supply of", thermometer: "thermometer of" };

// What a device showed last, with the current that was asked for.
function shown({ values, unit, commanded_A: commanded }) {
  const millimetres = (v) => `${fixed(1e3 * v, 2)} mm`;
  const degrees = (v) => `${fixed((180 * v) / Math.PI, 2)}°`;
  const digits = { T: (v) => size(v, "T", 4), m: millimetres, rad: degrees, A: (v) => (Math.abs(v) < 1e-9 ? "0 A" : `${minus(v.toPrecision(5))} A`), "°C": (v) => `${fixed(v, 1)} °C` }[unit];
  const told = values.map((v, i) => html`${i ? ", " : ""}<span class="nobr">${v === null ? "out of range" : digits(v)}</span>`);
  return commanded === null ? told : html`${told} of <span class="nobr">${minus(String(commanded))} A</span>`;
}

const deviceState = ({ n_silent: n }) =>
  n === 0 ? "in the last reading" : html`<strong class="warn">silent for ${n} ${n === 1 ? "reading" : "readings"}</strong>`;

const VERDICTS = { nothing_found: "nothing found", partly_explained: "explained in part", unexplained: "something unexplained" };

// What the latest diagnosis of the readings so far says, and of how many.
function verdict({ diagnosis, has_ended: hasEnded }) {
  if (!diagnosis) return ["none yet", hasEnded ? "" : "from 15 readings on, in the background"];
  const after = `after ${diagnosis.n_readings} readings`;
  return [diagnosis.causes.length ? diagnosis.causes.join(", ") : (VERDICTS[diagnosis.verdict] ?? diagnosis.verdict), after];
}

// How near the estimate is to what a fit of all readings at once would give.
function standing({ intervals, is_polished: isPolished, has_ended: hasEnded }) {
  if (!Object.keys(intervals).length) return "";
  if (isPolished) return "Polished: the same as a fit of all readings so far.";
  return hasEnded ? "Not polished: a fit of all readings may differ a little." : "Not polished yet: a fit of all readings so far may differ a little.";
}

const tile = (name, value, more) =>
  html`<div class="tile"><dt>${name}</dt><dd>${value}</dd>${more ? html`<dd class="muted">${more}</dd>` : null}</div>`;
