// Predictions of a calibration with their intervals: the field at a point, or over a plane.

import { html } from "./vendor/lit-html.js";
import { post, Problem } from "./api.js";
import { heat } from "./chart.js";
import { figure } from "./figure.js";
import { size } from "./words.js";

const AXES = ["x", "y", "z"];
const PLANES = [["x", "z"], ["y", "z"], ["x", "y"]];
const ACROSS = 31; // points along each side of a plane

export class Prediction {
  isPlane = false;
  told = null;
  fault = null;

  constructor(update, id, { coils, movers }) {
    Object.assign(this, { update, id, coils, movers });
  }

  template() {
    const choose = (event) => {
      [this.isPlane, this.told, this.fault] = [event.target.value === "plane", null, null];
      this.update();
    };
    return html`<section aria-labelledby="predict">
      <h2 id="predict">Predict the field</h2>
      <form class="card form" @submit=${(event) => this.send(event)}>
        <label>Where <select @change=${choose}><option value="point">at a point</option><option value="plane">over a plane</option></select></label>
        ${this.isPlane ? plane() : html`<p class="fields">${AXES.map((axis) => html`<label>${axis} (mm) ${number("point", 0)}</label>`)}</p>`}
        <p class="fields">${this.coils.map((coil, i) => html`<label>current of ${coil} (A) ${number("current", i ? 0 : 1)}</label>`)}</p>
        ${Object.entries(this.movers).map(([mover, columns]) => html`<label>${mover} <input name="motion" class="wide" value="0 0 0 0 0 0"
            aria-describedby="motion-${mover}" required /></label><p class="muted" id="motion-${mover}">${columns.join(", ")}; six numbers in SI.</p>`)}
        ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
        <button class="main">Predict</button>
        <div role="status">${this.told && !this.isPlane ? this.table() : null}</div>
      </form>
      ${this.told && this.isPlane ? this.map() : null}
    </section>`;
  }

  async send(event) {
    event.preventDefault();
    const form = new FormData(event.target);
    const currents = form.getAll("current").map(Number);
    const motions = form.getAll("motion").map((text) => text.trim().split(/[\s,;]+/).map(Number));
    const wish = {
      currents_A: Object.fromEntries(this.coils.map((coil, i) => [coil, currents[i]])),
      motion: Object.fromEntries(Object.keys(this.movers).map((mover, i) => [mover, motions[i]])),
    };
    [this.fault, this.told] = [null, null];
    try {
      this.told = this.isPlane ? await this.askPlane(form, wish) : await post(this.path("predict"), { ...wish, points_m: [metres(form, "point")] });
    } catch (error) {
      if (!(error instanceof Problem) || error.status === 401) throw error;
      this.fault = error.message; // beside the form, so that what was filled in stays
    }
    this.update();
  }

  path(what) {
    return `/v1/calibrations/${this.id}/${what}`;
  }

  async askPlane(form, wish) {
    this.sides = PLANES[Number(form.get("plane"))];
    const [[at], [reach]] = [metres(form, "at"), metres(form, "reach")];
    const along = { first_m: -reach, last_m: reach, n: ACROSS };
    const axes = AXES.map((axis) => [axis, this.sides.includes(axis) ? along : { first_m: at, last_m: at, n: 1 }]);
    return post(this.path("grid"), { ...wish, ...Object.fromEntries(axes) });
  }

  table() {
    const { told } = this;
    if (told.field_T[0][0] === null) return html`<p>This point is inside a winding.</p>`;
    const rows = AXES.map((axis, i) => [`B${axis}`, told.field_T[0][i], told.field_lower_T[0][i], told.field_upper_T[0][i]]);
    return html`<div class="scroll" tabindex="0" role="region" aria-label="Prediction"><table>
        <thead><tr><th>component</th><th class="num">field</th><th class="num">90 % interval</th></tr></thead>
        <tbody>${rows.map(([name, value, low, high]) => html`<tr><th scope="row">${name}</th><td class="num">${size(value, "T", 5)}</td>
          <td class="num">${size(low, "T", 5)} to ${size(high, "T", 5)}</td></tr>`)}
          <tr><th scope="row">|B|</th><td class="num">${size(Math.hypot(...told.field_T[0]), "T", 5)}</td><td class="num">–</td></tr></tbody></table></div>`;
  }

  map() {
    const { told, sides } = this;
    const [across, up] = sides.map((axis) => told[`${axis}_m`]);
    // Points come with z fastest and x slowest, so the second side of a plane changes fastest.
    const rows = (of) => up.map((_, i) => across.map((_, j) => of(j * up.length + i)));
    const isThere = (k) => told.field_T[k][0] !== null;
    const half = (k) => told.field_T[k].map((_, i) => (told.field_upper_T[k][i] - told.field_lower_T[k][i]) / 2);
    const axes = { xLabel: `${sides[0]} (mm)`, yLabel: `${sides[1]} (mm)` };
    const drawn = (name, of, options) => heat(name, across.map((v) => 1e3 * v), up.map((v) => 1e3 * v), rows((k) => (isThere(k) ? of(k) : null)), { ...axes, ...options });
    const points = told.x_m.flatMap((x) => told.y_m.flatMap((y) => told.z_m.map((z) => [x, y, z])));
    const table = () => [
      ["x_m", "y_m", "z_m", ...["B", "lower_B", "upper_B"].flatMap((name) => AXES.map((axis) => `${name}${axis}_T`))],
      ...points.map((point, k) => [...point, ...told.field_T[k], ...told.field_lower_T[k], ...told.field_upper_T[k]]),
    ];
    return html`<div class="figures two even">
      ${figure("predicted", "Predicted field", "Size of the field, on a logarithmic scale; empty inside windings. The CSV has all components with their intervals.",
        drawn("Predicted field", (k) => 1e3 * Math.hypot(...told.field_T[k]), { label: "|B| (mT)", log: true }), table)}
      ${figure("half_width", "Half-width of the 90 % interval", "Of the three components together.",
        drawn("Half-width of the interval", (k) => 1e6 * Math.hypot(...half(k)), { label: "µT" }), table)}
    </div>`;
  }
}

const number = (name, value) => html`<input name=${name} type="number" step="any" value=${value} required />`;

const plane = () => html`<p class="fields">
    <label>plane <select name="plane">${PLANES.map((sides, i) => html`<option value=${i}>${sides.join(" and ")}</option>`)}</select></label>
    <label>at (mm) ${number("at", 0)}</label>
    <label>from the middle (mm) <input name="reach" type="number" step="any" min="0.001" value="50" required /></label></p>`;

const metres = (form, name) => form.getAll(name).map((v) => Number(v) / 1e3);
