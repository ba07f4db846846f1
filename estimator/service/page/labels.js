// Name, note and tags of sessions and jobs: shown, edited, searched and sorted by.

import { html } from "./vendor/lit-html.js";
import { ask, Problem } from "./api.js";

const ORDERS = {
  newest: ["newest first", (a, b) => b.created.localeCompare(a.created)],
  measured: ["by date measured", (a, b) => (b.measured ?? b.created).localeCompare(a.measured ?? a.created)],
  name: ["by name", (a, b) => (a.name ?? "\uffff").localeCompare(b.name ?? "\uffff")],
};

// Search and order of a list; `load` loads what was searched for.
export class Finder {
  text = "";
  order = "newest";

  constructor(load, update, orders = Object.keys(ORDERS)) {
    Object.assign(this, { load, update, orders });
  }

  get query() {
    return this.text ? `?${new URLSearchParams({ search: this.text })}` : "";
  }

  sorted(items) {
    return [...items].sort(ORDERS[this.order][1]);
  }

  template(what) {
    const search = (event) => {
      event.preventDefault();
      this.text = event.target.elements.search.value.trim();
      this.load();
    };
    const sort = (event) => {
      this.order = event.target.value;
      this.update();
    };
    return html`<form class="row finder" role="search" @submit=${search}>
      <label>Search ${what} <input name="search" type="search" .value=${this.text} /></label>
      <button>Search</button>
      <label>Order
        <select @change=${sort}>
          ${this.orders.map((key) => html`<option value=${key} ?selected=${key === this.order}>${ORDERS[key][0]}</option>`)}
        </select></label>
    </form>`;
  }
}

// What people call a session or a job, below its heading.
export function labels(item) {
  const tags = item.tags.map((tag) => html`<span class="state">${tag}</span> `);
  return item.note || item.tags.length ? html`<p>${tags}${item.note}</p>` : null;
}

// A folded form that changes them; `after` is called with the item as it is then.
export function labelForm(path, label, item, after, { hasDate = false } = {}) {
  const save = async (event) => {
    event.preventDefault();
    const { name, note, tags, measured } = event.target.elements;
    const body = { name: name.value.trim() || null, note: note.value.trim() || null, tags: tags.value.split(/[\s,]+/).filter(Boolean) };
    if (measured?.value && measured.value !== item.measured?.slice(0, 10)) body.measured = measured.value;
    const said = event.target.querySelector("[role=alert]");
    said.textContent = "";
    try {
      Object.assign(item, await ask("PATCH", `${path}/${item.id}`, { body }));
    } catch (error) {
      if (!(error instanceof Problem) || error.status === 401) throw error;
      said.textContent = error.message;
      return;
    }
    event.target.closest("details").open = false;
    after();
  };
  return html`<details class="labels">
    <summary aria-label="Labels of ${label}">Labels</summary>
    <form class="row" @submit=${save}>
      <label>Name <input name="name" maxlength="200" .value=${item.name ?? ""} /></label>
      <label>Tags <input name="tags" .value=${item.tags.join(" ")} /></label>
      ${hasDate ? html`<label>Measured <input name="measured" type="date" .value=${(item.measured ?? item.created).slice(0, 10)} /></label>` : null}
      <label>Note <input name="note" class="wide" maxlength="5000" .value=${item.note ?? ""} /></label>
      <button>Save</button>
      <p role="alert"></p>
    </form>
  </details>`;
}
