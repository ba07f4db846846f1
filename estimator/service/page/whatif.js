// What if: a cause, its size on a slider, and the pattern that it would leave. The service says it once; the slider scales it here.

import { html } from "./vendor/lit-html.js";
import { get } from "./api.js";
import { figure } from "./figure.js";
import { arrowScale, extentOf, space, Viewpoint } from "./space.js";
import { short, size } from "./words.js";

const STEPS = 100;
const MOST_TYPICAL = 3; // standard deviations of the prior at the ends of the slider
const MOST_VISIBLE = 10; // or so many times the smallest visible size, where that is less
const STRONG_SIGMA = 3;

export class WhatIfView {
  causes = null;
  told = null;
  quantity = 0;
  step = 40;

  constructor(update, id) {
    Object.assign(this, { update, id, title: "what if", view: new Viewpoint(update) });
  }

  async load() {
    this.causes = await get(`/v1/sessions/${this.id}/causes`);
    const first = this.causes.find((one) => one.label.startsWith("axis_gain")) ?? this.causes[0];
    if (first) await this.choose(first.label);
  }

  async choose(label) {
    [this.label, this.told, this.fault, this.quantity] = [label, null, null, 0];
    this.update();
    try {
      const told = await get(`/v1/sessions/${this.id}/what-if?cause=${encodeURIComponent(label)}`);
      if (this.label === label) this.told = told;
    } catch (error) {
      this.fault = error.message;
    }
    this.update();
  }

  template() {
    return html`<h1>What if</h1>
      <p class="lead">Choose a cause and its size, and see what it would do to the readings of session ${short(this.id)}.</p>
      ${this.causes === null ? html`<p class="waiting">Fitting the session</p>` : this.controls()}
      ${this.fault ? html`<p class="fault" role="alert">${this.fault}</p>` : null}
      ${this.told ? this.panels() : this.causes && !this.fault ? html`<p class="waiting">Working it out</p>` : null}`;
  }

  controls() {
    const kinds = [...new Set(this.causes.map((one) => one.kind))];
    const pattern = this.told?.patterns[this.quantity];
    return html`<div class="card row">
      <label>Cause <select @change=${(e) => this.choose(e.target.value)}>
        ${kinds.map((kind) => html`<optgroup label=${kind}>
          ${this.causes.filter((one) => one.kind === kind).map((one) => html`<option value=${one.label} ?selected=${one.label === this.label}>${one.label}</option>`)}
        </optgroup>`)}</select></label>
      ${this.told && this.told.patterns.length > 1
        ? html`<label>Quantity <select @change=${(e) => { this.quantity = Number(e.target.value); this.update(); }}>
            ${this.told.patterns.map((one, i) => html`<option value=${i} ?selected=${i === this.quantity}>${one.words}</option>`)}</select></label>`
        : null}
      ${pattern
        ? html`<label class="grow">Size: <output>${size(this.size(pattern), pattern.unit)}</output>
            <input type="range" min=${-STEPS} max=${STEPS} .value=${this.step} aria-label="Size of ${this.label}"
              aria-valuetext=${size(this.size(pattern), pattern.unit)}
              @input=${(e) => { this.step = Number(e.target.value); this.update(); }} /></label>`
        : null}
    </div>`;
  }

  largest(pattern) {
    const typical = MOST_TYPICAL * pattern.typical;
    return pattern.visible ? Math.min(typical, MOST_VISIBLE * pattern.visible) : typical;
  }

  size(pattern) {
    return (this.step / STEPS) * this.largest(pattern);
  }

  panels() {
    const { told, view } = this;
    const pattern = told.patterns[this.quantity];
    const value = this.size(pattern);
    const left = Math.hypot(1, pattern.left_sigma * value);
    const extent = extentOf(told.position_m, told.winding);
    const largest = this.largest(pattern);
    const scaled = (vectors, by) => vectors.map((v) => v.map((c) => c * by));
    const drawn = (name, title, caption, unit_T) => {
      const vectors = scaled(unit_T, value);
      const field = arrowScale(scaled(unit_T, largest));
      const kinds = vectors.map((v) => (Math.hypot(...v) > STRONG_SIGMA * told.noise_T ? "strong" : "weak"));
      return figure(name, title, caption,
        space({ name: title, points: told.position_m, vectors, kinds, winding: told.winding, extent, field, view }),
        () => [["x_m", "y_m", "z_m", "Bx_T", "By_T", "Bz_T"], ...told.position_m.map((p, i) => [...p, ...vectors[i]])]);
    };
    const visible = !pattern.visible || pattern.visible > MOST_TYPICAL * pattern.typical
      ? "These readings cannot show it at any plausible size: the fit follows it."
      : `These readings show it from ${size(pattern.visible, pattern.unit)} on (five standard deviations).`;
    return html`<section class="card" aria-live="polite"><h2>${told.label}: ${told.words}</h2>
        <p>At ${size(value, pattern.unit)} a fit would leave <strong>${left.toFixed(2)} times the noise</strong>. ${visible}
          ${Math.abs(value) > 0.5 * pattern.typical ? "To first order; at large sizes the truth bends." : ""}</p></section>
      <div class="figures two even">
        <div class="before">${drawn("added", "What it adds to the field that is read", `In the frame of ${told.coil}. Coloured over three standard deviations of the noise.`, pattern.added_T)}</div>
        <div class="pattern">${drawn("left", "What is left once all else has been fitted", "The part that no other parameter can take up, with arrows of its own scale.", pattern.left_T)}</div>
      </div>`;
  }
}
