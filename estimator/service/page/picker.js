// Columns of a table that is no readings CSV: what each is taken for, with its first rows, and a choice of what else it may be.

import { html } from "./vendor/lit-html.js";
import { ask, Problem } from "./api.js";

const LEFT_OUT = "-";

export class ColumnPicker {
  chosen = new Map(); // what the user says of a column, by its header

  constructor(update, rigId, file) {
    Object.assign(this, { update, rigId, file });
  }

  // Parameters of an import by what was chosen.
  query(more = {}) {
    const query = new URLSearchParams({ rig_id: this.rigId, ...more });
    for (const [header, name] of this.chosen) query.append("column", `${header}=${name}`);
    return query;
  }

  async load() {
    this.preview = await ask("POST", `/v1/sessions/preview-csv?${this.query()}`, { body: this.file, type: "text/csv" });
    this.update();
  }

  get isReadable() {
    return this.preview?.n_readings != null;
  }

  template() {
    if (!this.preview) return null;
    const { columns, lines, remarks, names, n_readings, fault } = this.preview;
    const choose = async (header, name) => {
      this.chosen.set(header, name);
      try {
        await this.load();
      } catch (error) {
        if (!(error instanceof Problem) || error.status === 401) throw error;
        Object.assign(this.preview, { fault: error.message, n_readings: null });
        this.update();
      }
    };
    return html`<div class="picker">
      <p>${remarks.join(" ")} ${this.isReadable ? html`<strong>${n_readings} readings.</strong> Are these numbers right?` : null}</p>
      ${fault ? html`<div class="fault" role="alert">${fault.split("\n").map((words) => html`<p>${words}</p>`)}</div>` : null}
      <div class="scroll" tabindex="0" role="region" aria-label="Columns of the table">
        <table>
          <thead>
            <tr><th scope="col">column</th><th scope="col">is</th>${lines.map((line) => html`<th scope="col">line ${line}</th>`)}</tr>
          </thead>
          <tbody>
            ${columns.map(
              ({ header, name, values }) => html`<tr>
                <th scope="row">${header}</th>
                <td>
                  <select aria-label="What ${header} is" .value=${name} @change=${(event) => choose(header, event.target.value)}>
                    ${[...new Set([name, ...names])].map(
                      (one) => html`<option value=${one} ?selected=${one === name}>${one === LEFT_OUT ? "left out" : one}</option>`,
                    )}
                  </select>
                </td>
                ${values.map((value) => html`<td>${value}</td>`)}
              </tr>`,
            )}
          </tbody>
        </table>
      </div>
    </div>`;
  }
}
