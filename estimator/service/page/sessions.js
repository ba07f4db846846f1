// Sessions: what was measured, and what to do with it.

import { html } from "./vendor/lit-html.js";
import { all, ask, post, Problem } from "./api.js";
import { Finder, labelForm, labels } from "./labels.js";
import { ColumnPicker } from "./picker.js";
import { age, short } from "./words.js";

export class SessionsView {
  title = "sessions";
  sessions = null;
  rigs = [];

  constructor(update) {
    this.update = update;
    this.finder = new Finder(() => this.load(), update);
  }

  async load() {
    [this.sessions, this.rigs] = await Promise.all([all(`/v1/sessions${this.finder.query}`), all("/v1/rigs")]);
    this.update();
  }

  async begin(kind, session) {
    const seed = 1;
    const job = await post(`/v1/jobs/${kind}`, { session_id: session.id, seed });
    location.hash = `#/jobs/${job.id}`;
  }

  template() {
    if (this.sessions === null) return html`<h1>Sessions</h1><p class="waiting">Loading</p>`;
    const names = new Map(this.rigs.map((rig) => [rig.id, rig.name]));
    return html`<h1>Sessions</h1>
      ${this.sessions.length || this.finder.text ? this.finder.template("sessions") : null}
      ${this.sessions.length === 0 ? html`<p>${this.finder.text ? "No session has these words." : "No readings have arrived yet."}</p>` : null}
      <ul class="list">
        ${this.finder.sorted(this.sessions).map((session) => this.row(session, names.get(session.rig_id) ?? short(session.rig_id)))}
      </ul>
      ${this.upload()}`;
  }

  row(session, rig) {
    const label = `session ${short(session.id)}`;
    const isOpen = session.state === "open";
    return html`<li class="card row">
      <div class="grow">
        <h2>${session.name ?? rig}</h2>
        ${labels(session)}
        <p>
          ${isOpen ? html`<strong>open</strong>` : `${session.n_readings} readings`}, measured ${age(session.measured ?? session.created)},
          ${session.user}${session.name ? html`, rig ${rig}` : null} <span class="muted">${session.source.slice(0, 80)} · ${short(session.id)}</span>
        </p>
        ${labelForm("/v1/sessions", label, session, () => this.update(), { hasDate: true })}
      </div>
      <div class="actions">
        ${isOpen
          ? html`<a class="button" href="#/live/${session.id}" aria-label="Watch ${label}">Watch live</a>
              <button aria-label="Close ${label}" @click=${() => this.close_(session)}>Close</button>`
          : html`<button class="main" aria-label="Diagnose ${label}" @click=${() => this.begin("diagnose", session)}>Diagnose</button>
              <button aria-label="Calibrate ${label}" @click=${() => this.begin("calibrate", session)}>Calibrate</button>
              <a class="button" href="#/new/recalibrate/${session.id}" aria-label="Recalibrate with ${label}">Recalibrate</a>
              <a class="button" href="#/new/design/${session.id}" aria-label="Next readings after ${label}">Next readings</a>
              <a class="button" href="#/what-if/${session.id}" aria-label="What if, for ${label}">What if</a>
              <a class="button" href="/v1/sessions/${session.id}/readings.csv" download aria-label="Readings of ${label} as CSV">CSV</a>`}
      </div>
    </li>`;
  }

  async close_(session) {
    await post(`/v1/sessions/${session.id}/close`);
    await this.load();
  }

  upload() {
    const send = async (event) => {
      event.preventDefault();
      const { rig, file } = event.target.elements;
      const table = file.files[0];
      this.fault = null;
      try {
        if (table.name.endsWith(".zip")) {
          await ask("POST", `/v1/sessions/import-zip?rig_id=${rig.value}`, { body: table, type: "application/zip" });
        } else if (!this.picker && !(await this.isPlain(rig.value, table))) {
          return this.update(); // the columns are shown first
        } else {
          const query = this.picker ? this.picker.query({ accept: true }) : new URLSearchParams({ rig_id: rig.value });
          await ask("POST", `/v1/sessions/import-csv?${query}`, { body: table, type: "text/csv" });
        }
      } catch (error) {
        if (!(error instanceof Problem) || error.status === 401) throw error;
        this.fault = error.message; // beside the form, so that what was chosen stays
        this.update();
        return;
      }
      this.picker = null;
      event.target.reset();
      await this.load();
    };
    const forget = () => {
      this.picker = this.fault = null;
      this.update();
    };
    return html`<form class="card row" @submit=${send} @change=${(event) => event.target.closest(".picker") || forget()}>
      <label>Readings (CSV or another table, or a zipped session)
        <input name="file" type="file" accept=".csv,.txt,.dat,.tsv,.zip" required /></label>
      <label>of the rig
        <select name="rig">
          ${this.rigs.map((rig) => html`<option value=${rig.id}>${rig.name} (${short(rig.id)})</option>`)}
        </select></label>
      ${this.picker?.template()}
      ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
      <button ?disabled=${this.picker && !this.picker.isReadable}>${this.picker ? "Import it so" : "Upload"}</button>
    </form>`;
  }

  // Whether a table is a readings CSV; what was understood of another one is shown, and waits for an answer.
  async isPlain(rigId, table) {
    const picker = new ColumnPicker(() => this.update(), rigId, table);
    await picker.load();
    if (picker.isReadable && !picker.preview.remarks.length) return true;
    this.picker = picker;
    return false;
  }
}
