// Forms that ask for work: the judgement of a session, a batch of sessions, a proposal of the next readings.

import { html } from "./vendor/lit-html.js";
import { all, ask, get, post, Problem } from "./api.js";
import { age, jobName, short } from "./words.js";

const TOLD = {
  recalibrate: "Judges a session against the version of its rig that is in use: does it still hold, and what replaces it? The first session of a rig makes the first version.",
  batch: "Fits every session under every hypothesis, and says how probable each hypothesis is.",
  design: "Proposes which readings to take next, as a plan that the instruments can carry out.",
};
const AIMS = [
  ["shrink", "Know a parameter better", "Parameter"],
  ["split", "Tell causes apart", "Causes, separated by spaces"],
  ["correction", "Map a smooth correction", "Correction, as coil_harmonics[coil1]"],
];

export class NewJobView {
  sessions = null;
  aim = "shrink";

  constructor(update, kind, sessionId) {
    Object.assign(this, { update, kind, sessionId, title: `new ${jobName(kind)}` });
  }

  async load() {
    const [sessions, rigs] = await Promise.all([all("/v1/sessions"), all("/v1/rigs")]);
    const names = new Map(rigs.map((rig) => [rig.id, rig.name]));
    this.sessions = sessions.filter((one) => one.state === "closed").map((one) => ({ ...one, rig: names.get(one.rig_id) }));
    this.sessionId ??= this.sessions[0]?.id;
    this.update();
    if (this.kind === "design" && this.sessionId) await this.suggest();
  }

  // Names to choose from; causes take a fit of the session, so they come later.
  async suggest() {
    const session = this.sessions.find((one) => one.id === this.sessionId);
    this.suggested = null;
    const text = await get(`/v1/rigs/${session.rig_id}/text`);
    const rig = await ask("POST", "/v1/rigs/validate", { body: text, type: "application/yaml" });
    this.suggested = { shrink: rig.free_parameters, split: [] };
    this.update();
    const causes = await get(`/v1/sessions/${session.id}/causes`);
    if (session.id !== this.sessionId) return;
    this.suggested.split = causes.map((one) => one.label);
    this.update();
  }

  template() {
    if (!TOLD[this.kind]) return html`<p class="fault" role="alert">There is no such job.</p>`;
    const head = html`<h1>New ${jobName(this.kind).toLowerCase()}</h1><p class="lead">${TOLD[this.kind]}</p>`;
    if (this.sessions === null) return html`${head}<p class="waiting">Loading</p>`;
    if (!this.sessions.length) return html`${head}<p>It needs a closed session. <a href="#/sessions">Upload one.</a></p>`;
    return html`${head}
      <form class="card form" @submit=${(event) => this.send(event)}>
        ${this.kind === "batch" ? this.batch() : this.session()} ${this.kind === "design" ? this.design() : this.seed()}
        ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
        <button class="main">Start</button>
      </form>`;
  }

  session() {
    const choose = (event) => {
      this.sessionId = event.target.value;
      if (this.kind === "design") this.suggest();
    };
    return html`<label>Session <select name="session" @change=${choose}>
      ${this.sessions.map((one) => html`<option value=${one.id} ?selected=${one.id === this.sessionId}>${described(one)}</option>`)}
    </select></label>`;
  }

  seed() {
    return html`<label>Seed of everything random <input name="seed" type="number" min="0" max="4294967295" value="1" required /></label>`;
  }

  batch() {
    return html`<fieldset><legend>Sessions</legend>
        ${this.sessions.map((one) => html`<label><input type="checkbox" name="sessions" value=${one.id} ?checked=${one.id === this.sessionId} /> ${described(one)}</label>`)}
      </fieldset>
      <label>Hypotheses, separated by spaces <input name="hypotheses" value="plain" required aria-describedby="hypotheses" /></label>
      <p class="muted" id="hypotheses"><code>plain</code> is the rig as described; <code>axis_gain</code> frees a cause in addition, <code>axis_gain+sensor_offset</code> two.</p>
      <label><input type="checkbox" name="each" /> Calibrate each coil by itself</label>
      <label><input type="checkbox" name="posterior" checked /> Sample the probable hypotheses</label>
      <label><input type="checkbox" name="described" /> Fit rigs as described, without a field of the room and zeros of sensors that they do not mention</label>`;
  }

  design() {
    const [, , label] = AIMS.find(([key]) => key === this.aim);
    return html`<fieldset><legend>Aim</legend>
        ${AIMS.map(([key, words]) => html`<label><input type="radio" name="aim" value=${key} ?checked=${key === this.aim}
          @change=${() => { this.aim = key; this.update(); }} /> ${words}</label>`)}
      </fieldset>
      <label>${label} <input name="what" list="suggested" required autocomplete="off" /></label>
      <datalist id="suggested">${(this.suggested?.[this.aim] ?? []).map((name) => html`<option value=${name}></option>`)}</datalist>
      ${this.aim === "correction" ? html`<label>Highest degree of its terms <input name="degree" type="number" min="1" max="5" value="3" required /></label>` : null}
      <label>Readings to propose <input name="n_readings" type="number" min="1" max="500" value="20" required /></label>`;
  }

  async send(event) {
    event.preventDefault();
    try {
      const job = await post(`/v1/jobs/${this.kind}`, this.body(new FormData(event.target)));
      location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      if (!(error instanceof Problem) || error.status === 401) throw error;
      this.fault = error.message; // beside the form, so that what was filled in stays
      this.update();
    }
  }

  body(form) {
    const seed = Number(form.get("seed"));
    if (this.kind === "recalibrate") return { session_id: form.get("session"), seed };
    if (this.kind === "batch") {
      return {
        session_ids: form.getAll("sessions"),
        hypotheses: listed(form.get("hypotheses")),
        is_each_coil: form.has("each"),
        has_posterior: form.has("posterior"),
        as_described: form.has("described"),
        seed,
      };
    }
    const what = form.get("what").trim();
    const body = { session_id: form.get("session"), n_readings: Number(form.get("n_readings")), [this.aim]: this.aim === "split" ? listed(what) : what };
    return this.aim === "correction" ? { ...body, degree: Number(form.get("degree")) } : body;
  }
}

const listed = (text) => text.split(/\s+/).filter(Boolean);

const described = (session) => `${session.rig}, ${session.n_readings} readings, ${age(session.created)} (${short(session.id)})`;
