// Jobs: what waits, runs and has ended.

import { html } from "./vendor/lit-html.js";
import { all, post } from "./api.js";
import { Finder, labelForm, labels } from "./labels.js";
import { age, jobName, short } from "./words.js";

const LOOK_EVERY_MS = 2000;

// Name of the rig of each session.
async function rigOfSessions() {
  const [sessions, rigs] = await Promise.all([all("/v1/sessions"), all("/v1/rigs")]);
  const names = new Map(rigs.map((rig) => [rig.id, rig.name]));
  return new Map(sessions.map((session) => [session.id, names.get(session.rig_id)]));
}

export class JobsView {
  title = "jobs";
  jobs = null;

  constructor(update) {
    this.update = update;
    this.finder = new Finder(() => this.look(), update, ["newest", "name"]);
  }

  async load() {
    this.rigs ??= await rigOfSessions();
    await this.look();
    if (this.isClosed) return;
    this.timer = setTimeout(() => this.load(), LOOK_EVERY_MS);
  }

  async look() {
    this.jobs = await all(`/v1/jobs${this.finder.query}`, 200);
    this.update();
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
  }

  template() {
    if (this.jobs === null) return html`<h1>Jobs</h1><p class="waiting">Loading</p>`;
    return html`<h1>Jobs</h1>
      <nav class="actions new" aria-label="New job">New
        ${["recalibrate", "batch", "design"].map((kind) => html`<a class="button" href="#/new/${kind}">${jobName(kind)}</a>`)}
      </nav>
      ${this.jobs.length || this.finder.text ? this.finder.template("jobs") : null}
      ${this.jobs.length === 0 ? html`<p>${this.finder.text ? "No job has these words." : "Nothing has been asked for yet."}</p>` : null}
      <ul class="list">
        ${this.finder.sorted(this.jobs).map(
          (job) => html`<li class="card row">
            <div class="grow">
              <h2><a href="#/jobs/${job.id}">${job.name ?? `${jobName(job.kind)} of ${this.rigs.get(job.session_id) ?? "a session"}`}</a></h2>
              ${labels(job)}
              <p>
                <span class="state ${job.state}">${job.state}</span> ${age(job.ended ?? job.started ?? job.created)},
                <span class="muted">job ${short(job.id)}, session ${short(job.session_id)}, ${job.user}</span> ${job.fault ? html`<br />${job.fault}` : null}
              </p>
              ${labelForm("/v1/jobs", `job ${short(job.id)}`, job, () => this.update())}
            </div>
            <div class="actions">${cancelButton(job, () => this.update())}</div>
          </li>`,
        )}
      </ul>`;
  }
}

export function cancelButton(job, after) {
  if (!["queued", "running"].includes(job.state)) return null;
  const cancel = async () => {
    Object.assign(job, await post(`/v1/jobs/${job.id}/cancel`));
    after();
  };
  return html`<button aria-label="Cancel ${job.kind} ${short(job.id)}" @click=${cancel}>Cancel</button>`;
}
