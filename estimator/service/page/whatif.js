import { html } from "./vendor/lit-html.js";
export class WhatIfView { title = "what if"; async load() {} template() { return html`<p>soon</p>`; } }
