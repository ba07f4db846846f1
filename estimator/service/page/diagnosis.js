// A diagnosis that a physicist understands in half a minute: what is wrong, where, how sure, and what it did.

import { html } from "./vendor/lit-html.js";
import { ask, download, post } from "./api.js";
import { bars, pairs } from "./chart.js";
import { figure } from "./figure.js";
import { arrowScale, extentOf, space, Viewpoint } from "./space.js";
import { breakable, minus, percent, rounded, short } from "./words.js";

const HALF_WIDTH_90 = 1.645;
const STRONG_SIGMA = 3; // from here on an arrow is hardly noise
const ROLES = { named: "named", alternative: "cannot be told from what was named", "stand-in": "stands in for something unknown", other: "not needed" };

export class Diagnosis {
  constructor(update, job, result, panels) {
    Object.assign(this, { update, job, result, panels, map: 0, race: 0 });
    this.view = new Viewpoint(update);
    this.pattern = Object.keys(panels.maps[0]?.patterns_T ?? {})[0];
  }

  template() {
    const { panels } = this;
    const [sentence, ...rest] = panels.headline;
    return html`<section class="hero card ${panels.verdict}">
        <p class="over">Diagnosis of ${panels.rig} · ${panels.n_readings} readings · job ${short(this.job.id)}</p>
        <h1 id="verdict">${sentence}</h1>
        ${this.tiles()} ${rest.map((words) => html`<p>${words}</p>`)} ${this.actions()}
      </section>
      ${panels.warnings.map((words) => html`<p class="warn card" role="note">${words}</p>`)}
      ${this.maps()} ${this.races()} ${this.impact()} ${this.next()}`;
  }

  // Whether the extended rig differs from the one described.
  get isChanged() {
    return this.panels.answers.length > 0 || ["unexplained", "partly_explained"].includes(this.panels.verdict);
  }

  tiles() {
    const { answers, left_sigma: left } = this.panels;
    const tile = (name, value, more) =>
      html`<div class="tile"><dt>${name}</dt><dd>${value}</dd>${more ? html`<dd class="muted">${more}</dd>` : null}</div>`;
    const after = this.isChanged ? ` → ${left[1].toFixed(2)}` : "";
    const fit = tile("Left over, in noise", `${left[0].toFixed(2)}${after}`, `root mean square${after ? ", as described → extended" : ""}`);
    if (!answers.length) return html`<dl class="tiles">${fit}</dl>`;
    return answers.slice(0, 3).map(
      (answer, i) => html`<dl class="tiles">
        ${tile("What", breakable([answer.label, ...twins(answer)].join(" or ")), answer.words)}
        ${tile("Where", answer.place, [answer.kind === answer.place ? "" : answer.kind, twins(answer).length ? `if it is ${answer.label}` : ""].filter(Boolean).join(", "))}
        ${tile("How sure", percent(answer.probability), answer.alternatives.length ? `or ${answer.alternatives.slice(0, 3).map(([name, p]) => `${name} ${percent(p)}`).join(", ")}` : "")}
        ${tile("How large", answer.sizes[0] ?? "not told", answer.sizes.slice(1, 3).join("; "))} ${i ? null : fit}
      </dl>`,
    );
  }

  actions() {
    const { result, job } = this;
    const rig = result.extended_rig;
    return html`<div class="actions">
      ${this.isChanged && rig
        ? html`<button class="main" ?disabled=${this.accepted} @click=${() => this.accept()}>Accept the extended rig</button>
            <button @click=${() => download("rig_extended.yaml", rig, "application/yaml")}>Download rig_extended.yaml</button>`
        : null}
      <a class="button" href="#/what-if/${job.session_id}">What if</a>
      <a class="button" href="/v1/jobs/${job.id}/report" target="_blank" rel="noopener">Full report</a>
      <span role="status">${this.accepted
        ? html`Version ${short(this.accepted.id)} of <a href="#/rigs">${this.accepted.name}</a> is kept.
            <button @click=${() => this.calibrate()}>Calibrate this session with it</button>`
        : null}</span>
    </div>`;
  }

  async accept() {
    this.accepted = await ask("POST", "/v1/rigs", { body: this.result.extended_rig, type: "application/yaml" });
    this.update();
  }

  async calibrate() {
    const body = { session_id: this.job.session_id, rig_id: this.accepted.id, seed: 1 };
    location.hash = `#/jobs/${(await post("/v1/jobs/calibrate", body)).id}`;
  }

  maps() {
    const { panels, view } = this;
    const map = panels.maps[this.map];
    if (!map) return null;
    const extent = extentOf(map.position_m, map.winding);
    const field = arrowScale(map.before_T);
    const noise = STRONG_SIGMA * panels.noise_T;
    const drawn = (name, vectors, kinds) =>
      space({
        name, points: map.position_m, vectors, winding: map.winding, extent, view, field,
        kinds: kinds ?? vectors.map((v) => (Math.hypot(...v) > noise ? "strong" : "weak")),
      });
    const rows = (vectors) => () => [
      ["x_m", "y_m", "z_m", "Bx_T", "By_T", "Bz_T"],
      ...map.position_m.map((p, i) => [...p, ...vectors[i]]),
    ];
    const pattern = map.patterns_T[this.pattern];
    return html`<section aria-labelledby="maps">
      <h2 id="maps">What is left at each place, around ${map.coil}</h2>
      <p class="lead">Each arrow is measured less predicted field, in the frame of ${map.coil}. Arrows over three standard deviations of the noise are
        coloured. Turn any view by dragging, or with the arrow keys: all turn together.</p>
      ${panels.maps.length > 1
        ? html`<label>Coil <select @change=${(e) => { this.map = Number(e.target.value); this.update(); }}>
            ${panels.maps.map((m, i) => html`<option value=${i}>${m.coil}</option>`)}</select></label>`
        : null}
      <div class="figures three before-after">
        <div class="before">${figure("residual-as-described", "As described", this.share(map.before_T), drawn("Residuals of the rig as described", map.before_T), rows(map.before_T))}</div>
        ${this.isChanged
          ? html`<div class="after">${figure("residual-extended", "Extended", this.share(map.after_T), drawn("Residuals of the extended rig", map.after_T), rows(map.after_T))}</div>`
          : null}
        ${pattern
          ? html`<div class="pattern">${figure(
              "pattern", html`<label>What <select aria-label="Hypothesis" @change=${(e) => { this.pattern = e.target.value; this.update(); }}>
                ${Object.keys(map.patterns_T).map((name) => html`<option ?selected=${name === this.pattern}>${name}</option>`)}</select>
              would have left</label>`,
              html`Without noise, once all else was fitted. ${this.left()}`,
              drawn(`Pattern of ${this.pattern}`, pattern, pattern.map(() => "strong")), rows(pattern),
            )}</div>`
          : null}
      </div>
    </section>`;
  }

  share(vectors) {
    const n = vectors.filter((v) => Math.hypot(...v) > STRONG_SIGMA * this.panels.noise_T).length;
    return `${n} of ${vectors.length} arrows are over three standard deviations.`;
  }

  left() {
    const runner = this.panels.races[0]?.runners.find((one) => one.label === this.pattern);
    const nothing = this.panels.races[0]?.runners.find((one) => one.label === "nothing");
    if (!runner?.left_sigma || !nothing?.left_sigma) return null;
    return `If this were it, ${runner.left_sigma.toFixed(2)} times the noise would be left; ${nothing.left_sigma.toFixed(2)} without it.`;
  }

  races() {
    const race = this.panels.races[this.race];
    if (!race) return null;
    const kind = (one) => (one.label === "unexplained" ? "left" : one.role);
    const rows = race.runners.map((one) => ({
      label: one.label, value: one.log_bayes_factor, role: kind(one), note: minus((Math.round(10 * one.log_bayes_factor) / 10 + 0).toFixed(1)),
    }));
    const table = () => [
      ["hypothesis", "meaning", "log_bayes_factor", "role", "left_over_in_noise"],
      ...race.runners.map((one) => [one.label, one.words, one.log_bayes_factor, one.role, one.left_sigma]),
    ];
    const names = this.panels.races.map((one, i) => `${i + 1}: ${one.taken ? `${one.taken} taken` : "nothing more"}`);
    return html`<section aria-labelledby="race">
      <h2 id="race">The race of hypotheses</h2>
      <p class="lead">Log evidence of each against nothing wrong: a lead of 3 is 20 to 1, of 7 a thousand to 1.</p>
      ${names.length > 1
        ? html`<label>Step <select @change=${(e) => { this.race = Number(e.target.value); this.update(); }}>
            ${names.map((name, i) => html`<option value=${i}>${name}</option>`)}</select></label>`
        : null}
      <div class="figures two">
        ${figure("hypotheses", race.taken ? `${race.taken} explains most` : "No further cause has enough evidence", "", bars("Log evidence of each hypothesis", rows, "log Bayes factor against nothing wrong"), table)}
        <div class="card scroll" tabindex="0" role="region" aria-label="Meaning of the hypotheses">
          <table>
            <thead><tr><th>hypothesis</th><th>meaning</th><th class="num">leaves (noise)</th></tr></thead>
            <tbody>
              ${race.runners.slice(0, 6).map((one) => html`<tr class=${kind(one)}>
                <th scope="row">${breakable(one.label)}</th><td>${one.words}${one.role === "other" ? null : html` <em>(${ROLES[one.role]})</em>`}</td>
                <td class="num">${one.left_sigma === null ? "–" : one.left_sigma.toFixed(2)}</td></tr>`)}
            </tbody>
          </table>
        </div>
      </div>
    </section>`;
  }

  impact() {
    const { moved, answers } = this.panels;
    if (!answers.length || !moved.length) return null;
    const told = ([value, sd], { factor }) => `${rounded(value * factor, sd * factor)}`;
    const rows = moved.map(({ shown, before, after }) => {
      const inSd = ([value, sd]) => [0, -1, 1].map((s) => (value + s * HALF_WIDTH_90 * sd - before[0]) / before[1]);
      const note = `${told(before, shown)} → ${rounded(after[0] * shown.factor, after[1] * shown.factor)} ± ${rounded(after[1] * shown.factor, after[1] * shown.factor)} ${shown.unit}`;
      return { label: shown.words, before: inSd(before), after: inSd(after), note };
    });
    const causes = [...new Set(moved.flatMap((one) => Object.keys(one.pulls_sd)))];
    const table = () => [
      ["parameter", "before", "before_sd", "after", "after_sd", "moved_sd", ...causes.map((c) => `pull of ${c} (sd)`)],
      ...moved.map((one) => [one.shown.name, ...one.before, ...one.after, one.moved_sd, ...causes.map((c) => one.pulls_sd[c])]),
    ];
    return html`<section aria-labelledby="impact">
      <h2 id="impact">What the flaw did to each parameter</h2>
      <p class="lead">${this.panels.moved_words}</p>
      ${figure("impact", "Values with 90 % credible intervals", "In standard deviations of the fit as described, from its value.",
        pairs("Parameters before and after the extension", rows, "shift (sd of the fit as described)"), table)}
    </section>`;
  }

  next() {
    const proposals = this.panels.next;
    if (!proposals.length) return null;
    return html`<section aria-labelledby="next">
      <h2 id="next">The next measurement</h2>
      <ol class="list">
        ${proposals.map((one, i) => html`<li class="card row">
          <div class="grow"><h3>Measure ${one.words}</h3><p>This ${one.why.replace(/^its/, "measurement pays: its")}. ${one.by_hand}</p></div>
          <button class=${i ? "" : "main"} aria-label="Plan of proposal ${i + 1}" @click=${() => download(`next_${i + 1}.yaml`, one.plan, "application/yaml")}>
            Download the plan (${one.n_stops} stops)</button>
        </li>`)}
      </ol>
    </section>`;
  }
}

// Alternatives that are nearly as probable as what was named.
const twins = ({ probability, alternatives }) => alternatives.filter(([, p]) => p > 0.5 * probability).map(([name]) => name);
