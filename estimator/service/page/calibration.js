// A calibration as its report tells it: how good it is, fields and their uncertainty, what the data taught, residuals; and predictions.

import { html } from "./vendor/lit-html.js";
import { all, ask, download, Problem } from "./api.js";
import { heat, intervals, lines } from "./chart.js";
import { figure } from "./figure.js";
import { Prediction } from "./prediction.js";
import { intervalTable } from "./rigs.js";
import { age, minus, percent, short, size } from "./words.js";

const FORMATS = [["json", "JSON"], ["cpp", "C++"], ["matlab", "MATLAB"], ["magpylib", "magpylib"], ["arviz", "ArviZ"]];
const STRONG_SIGMA = 3;

export class Calibration {
  plane = 0;

  constructor(update, job, { calibration_id: id, result }, panels) {
    Object.assign(this, { update, job, id, summary: result, panels });
    this.prediction = new Prediction(update, id, panels);
  }

  template() {
    const [sentence, ...rest] = this.panels.headline;
    return html`<section class="hero card ${this.panels.verdict ?? ""}">
        <p class="over">Calibration of ${this.summary.rig_name ?? "a rig"} · job ${short(this.job.id)}</p>
        <h1 id="verdict">${sentence}</h1>
        ${this.tiles()} ${rest.map((words) => html`<p>${words}</p>`)} ${this.actions()}
      </section>
      ${this.warnings()}
      ${this.fields()} ${this.numbers()} ${this.residuals()} ${this.prediction.template()}`;
  }

  // Each by itself where they are few, else in one line that opens.
  warnings() {
    const { warnings } = this.panels;
    if (warnings.length <= 2) return warnings.map((words) => html`<p class="warn card" role="note">${words}</p>`);
    return html`<details class="warn card"><summary>${warnings.length} things that these readings leave open; the first: ${warnings[0]}</summary>
      <ol>${warnings.map((words) => html`<li>${words}</li>`)}</ol></details>`;
  }

  tiles() {
    const { rmse, rmse_nominal: nominal, coverage90, parameters, loop_counts: counts } = this.summary;
    const role = rmse.validation ? "validation" : "calibration";
    const unseen = role === "validation" ? "on unseen readings" : "on the readings of the fit";
    return html`<dl class="tiles">
      ${tile("Error, rms", size(rmse[role].vector_T, "T", 3), unseen)}
      ${tile("Before the fit", size(nominal[role].vector_T, "T", 3), `${(100 * nominal[role].relative).toPrecision(2)} % of the field`)}
      ${tile("In 90 % intervals", `${Math.round(100 * coverage90[role])} %`, "of the components; 90 % is right")}
      ${tile("Parameters", Object.keys(parameters).length, counts.length ? `${counts[0].coil}: ${counts[0].axial} × ${counts[0].radial} loops, ${percent(counts[0].probability)}` : "")}
    </dl>`;
  }

  actions() {
    return html`<div class="actions">
      <a class="button" href="/v1/jobs/${this.job.id}/report" target="_blank" rel="noopener">Full report</a>
      ${FORMATS.map(([to, words]) => html`<button aria-label="Export as ${words}" @click=${() => this.export_(to)}>${words}</button>`)}
      <a class="button" href="/v1/calibrations/${this.id}/calibration.zip" download>Folder as zip</a>
      ${this.comparison()}
      ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
    </div>`;
  }

  // Other calibrations of the rig; the page of both is made when it is opened.
  comparison() {
    if (this.others === undefined) {
      this.others = [];
      all(`/v1/calibrations?${new URLSearchParams({ rig_name: this.summary.rig_name })}`).then((listed) => {
        this.others = listed.filter((one) => one.id !== this.id);
        this.update();
      });
    }
    if (!this.others.length) return null;
    const open = (event) => {
      event.preventDefault();
      window.open(`/v1/calibrations/${this.id}/compare/${event.target.elements.other.value}/report`, "_blank", "noopener");
    };
    return html`<form class="row" @submit=${open}>
      <label>Compare with
        <select name="other">
          ${this.others.map((one) => html`<option value=${one.id}>${age(one.created)}, ${one.user} (${short(one.id)})</option>`)}
        </select></label>
      <button>Compare</button>
    </form>`;
  }

  async export_(to) {
    this.fault = null;
    try {
      const { content, name } = await ask("POST", `/v1/calibrations/${this.id}/export`, { body: { to }, isFile: true });
      download(name ?? `calibration.${to}`, content);
    } catch (error) {
      this.tell(error);
    }
    this.update();
  }

  // What an action could not do, said beside it.
  tell(error) {
    if (!(error instanceof Problem) || error.status === 401) throw error;
    this.fault = error.message;
  }

  fields() {
    const { planes } = this.panels;
    const plane = planes[this.plane];
    if (!plane) return null;
    const across = plane.x_m.map((v) => 1e3 * v);
    const up = plane.z_m.map((v) => 1e3 * v);
    const table = (rows, name) => () => [
      ["x_m", "z_m", name],
      ...plane.z_m.flatMap((z, i) => plane.x_m.map((x, j) => [x, z, rows[i][j] ?? ""])),
    ];
    const scaled = (rows, factor) => rows.map((row) => row.map((v) => (v === null ? null : factor * v)));
    const axes = { xLabel: "x (mm)", yLabel: "z (mm)" };
    return html`<section aria-labelledby="field">
      <h2 id="field">Field of ${plane.coil} for one ampere, and how well it is known</h2>
      ${planes.length > 1
        ? html`<label>Coil <select @change=${(e) => { this.plane = Number(e.target.value); this.update(); }}>
            ${planes.map((one, i) => html`<option value=${i}>${one.coil}</option>`)}</select></label>`
        : null}
      <div class="figures two even">
        ${figure("field", "Field", "In the plane through the axis, on a logarithmic scale.",
          heat("Size of the field", across, up, scaled(plane.size_T_per_A, 1e3), { ...axes, label: "|B| (mT/A)", log: true }), table(plane.size_T_per_A, "B_T_per_A"))}
        ${figure("uncertainty", "Uncertainty", "Half-width of the 90 % credible interval: the model is known best where readings were taken.",
          heat("Relative uncertainty of the field", across, up, scaled(plane.relative, 100), { ...axes, label: "% of |B|" }), table(plane.relative, "relative"))}
      </div>
    </section>`;
  }

  numbers() {
    const { taught } = this.panels;
    const { loop_counts: counts } = this.summary;
    const rows = taught.map((one) => ({
      label: one.words, middle: one.middle, low: one.low, high: one.high,
      note: `${minus(one.middle.toFixed(2))} (${minus(one.low.toFixed(2))} to ${minus(one.high.toFixed(2))})`,
    }));
    return html`<section aria-labelledby="taught">
      <h2 id="taught">What the data taught</h2>
      <p class="lead">Posterior of each free number in standard deviations of its prior: the shorter the line, the more the readings told.</p>
      ${rows.length
        ? figure("taught", "Posterior beside the prior", "Grey: the prior's 90 %. Blue: median and 90 % interval.",
            intervals("Posterior beside the prior", rows, "prior standard deviations from its centre"),
            () => [["parameter", "median", "low", "high"], ...taught.map((one) => [one.name, one.middle, one.low, one.high])])
        : null}
      <div class="card">${intervalTable(this.summary)}</div>
      ${counts.length
        ? html`<div class="card scroll" tabindex="0" role="region" aria-label="Loop counts"><h3>Loop counts</h3><table>
            <thead><tr><th>coil</th><th class="num">axial</th><th class="num">radial</th><th class="num">probability</th></tr></thead>
            <tbody>${counts.slice(0, 10).map((one) => html`<tr><th scope="row">${one.coil}</th><td class="num">${one.axial}</td>
              <td class="num">${one.radial}</td><td class="num">${one.probability.toFixed(3)}</td></tr>`)}</tbody></table></div>`
        : null}
    </section>`;
  }

  residuals() {
    const { rms_sigma: rms, groups } = this.panels;
    const points = rms.map((value, i) => [i + 1, value]).filter(([, value]) => value !== null);
    const mean = (value) => (value === null ? "–" : minus((Math.round(100 * value) / 100 + 0).toFixed(2)));
    return html`<section aria-labelledby="residuals">
      <h2 id="residuals">What the fit leaves</h2>
      <div class="figures two">
        ${figure("residuals", "Residual of each reading", "Root mean square of its components in units of the noise; about 1 where the model holds.",
          lines("Residuals", [{ label: "", kind: "c0", points }], { xLabel: "reading", yLabel: "σ", mark: 1, dots: true }),
          () => [["number", "rms_sigma"], ...points])}
        <div class="card scroll" tabindex="0" role="region" aria-label="Residuals by group"><h3>By current, axis, height and sensor</h3><table>
          <thead><tr><th>group</th><th class="num">readings</th><th class="num">rms (σ)</th><th class="num">mean x, y, z (σ)</th></tr></thead>
          <tbody>${groups.map((one) => html`<tr><th scope="row">${one.by}: ${one.name}</th><td class="num">${one.n_readings}</td>
            <td class="num">${one.rms_sigma > STRONG_SIGMA ? html`<strong class="warn">${one.rms_sigma.toFixed(2)}</strong>` : one.rms_sigma.toFixed(2)}</td>
            <td class="num long">${one.mean_sigma.map(mean).join(", ")}</td></tr>`)}</tbody></table></div>
      </div>
    </section>`;
  }
}

const tile = (name, value, more) =>
  html`<div class="tile"><dt>${name}</dt><dd>${value}</dd>${more ? html`<dd class="muted">${more}</dd>` : null}</div>`;
