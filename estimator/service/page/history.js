// A rig over months: its parameters and conclusions over time, its versions, and the way back to an earlier one.

import { html } from "./vendor/lit-html.js";
import { all, get, post } from "./api.js";
import { fitting } from "./chart.js";
import { figure } from "./figure.js";
import { legend, timeline, utc } from "./timeline.js";

const MOST_ENTRIES = 200;
const time = (text) => Date.parse(/[zZ]|[+-]\d\d:\d\d$/.test(text) ? text : `${text}Z`);

export class HistoryView {
  title = "history";
  known = null;
  asked = null; // version that somebody wants to return to

  constructor(update, id) {
    Object.assign(this, { update, id, path: `/v1/rigs/${id}/registry` });
  }

  async load() {
    const [known, versions, entries] = await Promise.all([
      get(`${this.path}/history`),
      all(`${this.path}/versions`, MOST_ENTRIES),
      all(`${this.path}/entries`, MOST_ENTRIES),
    ]);
    known.sessions = known.sessions.map((one) => ({ ...one, time: time(one.taken) }));
    known.periods = known.periods.map((one) => ({ ...one, begin: time(one.begin), end: time(one.end) }));
    Object.assign(this, { known, versions, entries });
    this.update();
  }

  template() {
    const { known } = this;
    if (!known) return html`<p class="waiting">Loading</p>`;
    return html`<h1>${known.rig_name} over time</h1>
      ${known.current === null
        ? html`<p>No session has made a version yet. <a href="#/new/recalibrate">Judge one.</a></p>`
        : html`<p>Version ${known.current} is in use. ${this.last()}</p>`}
      ${known.sessions.length && known.periods.length ? this.drift() : null}
      ${this.versions.length ? this.table() : null}
      ${this.entries.length ? this.log() : null}
      ${this.dialog()}`;
  }

  last() {
    const [last] = this.entries;
    return html`Last conclusion: <strong>${words(last.conclusion)}</strong>, ${last.reason}.`;
  }

  drift() {
    const { known } = this;
    const names = [...new Set(known.periods.flatMap((one) => Object.keys(one.intervals)))];
    const present = new Set(known.sessions.map((one) => one.conclusion));
    const caption = html`Points are estimates of each session by itself with 90 % intervals; bands are the version in use, with its 90 % interval. A point off the band
      is a change; the band steps where another version took over.
      <span class="keys">${legend(present).map((one) => html`<span class="keyed">${one.drawing} ${one.words}</span>`)}</span>`;
    const drawing = timeline(`Parameters of ${known.rig_name} over time`, known, names, fitting(1180));
    return figure("history", "Parameters over time", caption, drawing, () => rows(known, names));
  }

  table() {
    return html`<section class="card"><h2>Versions</h2>
      <div class="scroll" tabindex="0" role="region" aria-label="Versions">
        <table>
          <thead><tr><th>version</th><th>readings of</th><th>conclusion</th><th>way back</th></tr></thead>
          <tbody>
            ${this.versions.map(
              (one) => html`<tr class=${one.is_current ? "named" : ""}>
                <th scope="row">${one.version}${one.is_current ? ", in use" : ""}</th>
                <td>${utc(time(one.taken))}</td><td>${words(one.conclusion)}</td>
                <td>${one.is_current ? "–" : html`<button aria-label="Return to version ${one.version}" @click=${() => this.ask(one.version)}>Return to it</button>`}</td>
              </tr>`,
            )}
          </tbody>
        </table>
      </div></section>`;
  }

  log() {
    return html`<section class="card"><h2>Log</h2>
      <ol class="list log">
        ${this.entries.map(
          (one) => html`<li><strong>${words(one.conclusion)}</strong>, ${one.reason}.
            <span class="muted">Readings of ${utc(time(one.taken || one.concluded))}; ${one.version === null ? "no version" : `version ${one.version}`} after it.</span></li>`,
        )}
      </ol></section>`;
  }

  dialog() {
    const { asked, known } = this;
    return html`<dialog aria-labelledby="asked" @close=${() => { this.asked = null; this.update(); }}>
      <h2 id="asked">Return to version ${asked}?</h2>
      <p>Version ${known.current} is in use now. Sessions from now on are judged against version ${asked}; no version is lost.</p>
      <div class="actions">
        <button class="main" @click=${() => this.rollBack()}>Use version ${asked}</button>
        <button autofocus @click=${(event) => event.target.closest("dialog").close()}>Keep version ${known.current}</button>
      </div>
    </dialog>`;
  }

  ask(version) {
    this.asked = version;
    this.update();
    requestAnimationFrame(() => document.querySelector("dialog").showModal());
  }

  async rollBack() {
    const version = this.asked;
    document.querySelector("dialog").close();
    await post(`${this.path}/roll-back`, { version });
    await this.load();
  }
}

const words = (conclusion) => conclusion.replace("_", " ");

// Everything that the figure shows, a row for each number, in SI.
function rows(known, names) {
  const of = (kind, version, begin, end, conclusion) => (name, median, low, high) =>
    [kind, version, begin, end, conclusion, name, known.units[name], median, low, high];
  const iso = (t) => new Date(t).toISOString();
  return [
    ["kind", "version", "begin", "end", "conclusion", "parameter", "unit", "value", "lower90", "upper90"],
    ...known.periods.flatMap((one) => {
      const row = of("version in use", one.version, iso(one.begin), iso(one.end), "");
      return names.filter((name) => one.intervals[name]).map((name) => row(name, one.intervals[name][1], one.intervals[name][0], one.intervals[name][2]));
    }),
    ...known.sessions.flatMap((one) => {
      const row = of("session", "", iso(one.time), "", one.conclusion);
      const shown = names.filter((name) => one.estimate[name]);
      if (!shown.length) return [row("", "", "", "")];
      return shown.map((name) => {
        const [value, sd] = one.estimate[name];
        return row(name, value, value - 1.645 * sd, value + 1.645 * sd);
      });
    }),
  ];
}
