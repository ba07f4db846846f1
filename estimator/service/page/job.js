// One job: its progress as it comes, then what it has found.

import { html } from "./vendor/lit-html.js";
import { get } from "./api.js";
import { Calibration } from "./calibration.js";
import { Diagnosis } from "./diagnosis.js";
import { conclusion, fits, proposal } from "./found.js";
import { cancelButton } from "./jobs.js";
import { jobName, short, when } from "./words.js";

export class JobView {
  job = null;
  told = [];

  constructor(update, id) {
    Object.assign(this, { update, id, title: `job ${short(id)}` });
  }

  async load() {
    this.job = await get(`/v1/jobs/${this.id}`);
    this.update();
    if (this.job.state === "done") await this.finish();
    else if (["queued", "running"].includes(this.job.state)) this.follow();
  }

  follow() {
    this.events = new EventSource(`/v1/jobs/${this.id}/events`);
    this.events.addEventListener("progress", (event) => {
      const told = JSON.parse(event.data);
      if (this.told.at(-1)?.words === told.words) this.told.pop();
      this.told.push(told);
      if (this.job.state === "queued") this.job.state = "running";
      this.update();
    });
    this.events.addEventListener("end", async (event) => {
      this.close();
      this.job = JSON.parse(event.data);
      this.update();
      if (this.job.state === "done") await this.finish();
    });
  }

  close() {
    this.events?.close();
  }

  async finish() {
    this.result = await get(`/v1/jobs/${this.id}/result`);
    if (this.job.kind === "diagnose") {
      const panels = await get(`/v1/jobs/${this.id}/panels`);
      this.diagnosis = new Diagnosis(this.update, this.job, this.result, panels);
    }
    if (this.job.kind === "calibrate") {
      const panels = await get(`/v1/calibrations/${this.result.calibration_id}/panels`);
      this.calibration = new Calibration(this.update, this.job, this.result, panels);
    }
    if (this.job.kind === "recalibrate") {
      this.rigId = this.job.rig_id ?? (await get(`/v1/sessions/${this.job.session_id}`)).rig_id;
    }
    this.update();
  }

  template() {
    if (this.job === null) return html`<p class="waiting">Loading</p>`;
    if (this.diagnosis ?? this.calibration) return (this.diagnosis ?? this.calibration).template();
    return html`<h1>${jobName(this.job.kind)} ${short(this.id)}</h1>
      <p>
        <span class="state ${this.job.state}">${this.job.state}</span> asked for by ${this.job.user},
        ${when(this.job.created)} ${cancelButton(this.job, this.update)}
      </p>
      ${this.job.fault ? html`<p class="fault" role="alert">${this.job.fault}</p>` : null}
      ${this.result ? this.found() : this.progress()}`;
  }

  progress() {
    if (!["queued", "running"].includes(this.job.state)) return null;
    const last = this.told.at(-1);
    const [share, most] = last?.most ? [last.n_fitted, last.most] : [last?.smallest_ess, last?.target_ess];
    return html`<section class="card" aria-live="polite">
      <h2>${last ? last.words : "Waiting for a worker"}</h2>
      ${most > 0 ? html`<progress aria-label=${last.words} max=${most} value=${Math.min(share ?? 0, most)}></progress>` : html`<progress aria-label="Working"></progress>`}
      <ol class="steps">${this.told.slice(0, -1).map((one) => html`<li>${one.words}</li>`)}</ol>
    </section>`;
  }

  found() {
    const { result } = this.result;
    const report = html`<p><a class="button" href="/v1/jobs/${this.id}/report" target="_blank" rel="noopener">Report</a></p>`;
    if (this.job.kind === "design") return proposal(result);
    if (this.job.kind === "recalibrate") return html`${conclusion(result, this.rigId)} ${report}`;
    if (this.job.kind === "batch") return html`${fits(result)} ${report}`;
    return html`<p class="waiting">Loading</p>`;
  }
}
