import { html } from "./vendor/lit-html.js";
export class LiveView { title = "live"; async load() {} template() { return html`<p>soon</p>`; } }
