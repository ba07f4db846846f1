// Rigs: their versions, and what the newest calibration of each knows, with intervals and age.

import { html } from "./vendor/lit-html.js";
import { all, ask, get, Problem } from "./api.js";
import { age, breakable, rounded, short, shownIn, when } from "./words.js";

export class RigsView {
  title = "rigs";
  rigs = null;

  constructor(update) {
    this.update = update;
  }

  async load() {
    const [versions, calibrations] = await Promise.all([all("/v1/rigs"), all("/v1/calibrations")]);
    const names = [...new Set(versions.map((version) => version.name))];
    this.rigs = names.map((name) => ({
      name,
      versions: versions.filter((version) => version.name === name),
      calibrations: calibrations.filter((calibration) => calibration.rig_name === name),
    }));
    this.update();
    for (const rig of this.rigs) {
      if (!rig.calibrations.length) continue;
      rig.known = await get(`/v1/calibrations/${rig.calibrations[0].id}/intervals`);
      this.update();
    }
  }

  template() {
    return html`<h1>Rigs</h1>
      ${this.rigs === null
        ? html`<p class="waiting">Loading</p>`
        : this.rigs.map((rig) => rigCard(rig))}
      ${this.rigs?.length === 0 ? html`<p>No rig file has been uploaded yet.</p>` : null}
      ${this.upload()}`;
  }

  upload() {
    const send = async (event) => {
      event.preventDefault();
      const file = event.target.elements.file.files[0];
      this.fault = null;
      try {
        await ask("POST", "/v1/rigs", { body: await file.text(), type: "application/yaml" });
      } catch (error) {
        if (!(error instanceof Problem) || error.status === 401) throw error;
        this.fault = error.message; // beside the form, so that what was chosen stays
        this.update();
        return;
      }
      event.target.reset();
      await this.load();
      this.update();
    };
    return html`<form class="card row" @submit=${send}>
      <label>Rig file <input name="file" type="file" accept=".yaml,.yml" required /></label>
      <button>Upload</button>
      ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
    </form>`;
  }
}

function rigCard(rig) {
  const newest = rig.calibrations[0];
  return html`<section class="card" aria-label="Rig ${rig.name}">
    <h2>${rig.name}</h2>
    <p>
      ${rig.versions.length} ${rig.versions.length === 1 ? "version" : "versions"}, the last one
      <a href="/v1/rigs/${rig.versions[0].id}/text" target="_blank" rel="noopener">${short(rig.versions[0].id)}</a>
      uploaded ${age(rig.versions[0].created)} by ${rig.versions[0].user}
    </p>
    ${newest
      ? html`<p>
          Calibrated <strong>${age(newest.created)}</strong> (${when(newest.created)}),
          <a href="#/jobs/${newest.job_id}">job ${short(newest.job_id)}</a>
          · <a href="#/history/${rig.versions[0].id}">over time</a>
          ${rig.known && !rig.known.is_converged ? html`<strong class="warn">The chain has not converged.</strong>` : null}
        </p>`
      : html`<p class="muted">Not calibrated yet.</p>`}
    ${rig.known ? intervalTable(rig.known) : null}
  </section>`;
}

export function intervalTable(known) {
  return html`<div class="scroll" tabindex="0" role="region" aria-label="Credible intervals">
    <table>
      <thead>
        <tr><th>parameter</th><th class="num">median ± sd</th><th class="num">90 % credible interval</th><th>unit</th></tr>
      </thead>
      <tbody>
        ${Object.entries(known.parameters).map(([name, one]) => {
          const { factor, unit } = shownIn(one.unit);
          const sd = one.sd * factor;
          const [low, high] = one.ci90.map((end) => rounded(end * factor, sd));
          return html`<tr>
            <th scope="row">${breakable(name)}</th>
            <td class="num">${rounded(one.median * factor, sd)} ± ${rounded(sd, sd)}</td>
            <td class="num">${low} to ${high}</td>
            <td>${unit}</td>
          </tr>`;
        })}
      </tbody>
    </table>
  </div>`;
}
