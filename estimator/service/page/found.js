// What a recalibration, a batch or a design has found.

import { html } from "./vendor/lit-html.js";
import { download } from "./api.js";
import { fitting, lines } from "./chart.js";
import { csv, figure } from "./figure.js";
import { breakable, percent, shownIn, short, size } from "./words.js";

const CLEAR_LOG_EVIDENCE = 3;

// The conclusion on a session; `rigId` leads to the history of its rig.
export function conclusion(entry, rigId) {
  const made = entry.made === null ? "It made no version." : `It made version ${entry.made}.`;
  return html`<section class="card">
    <h2>${capital(entry.conclusion.replace("_", " "))}</h2>
    <p>${capital(entry.reason)}. ${made}</p>
    ${entry.causes.length ? html`<p>Named: ${entry.causes.map((one) => one.name.replaceAll("_", " ")).join(", ")}.</p>` : null}
    <p><a class="button" href="#/history/${rigId}">This rig over time</a></p>
  </section>`;
}

// Fits of a batch, the most probable hypothesis of each session first.
export function fits({ fits: found, failed }) {
  const ranked = [...found].sort((a, b) => a.session.localeCompare(b.session) || b.probability - a.probability);
  const columns = [...new Set(found.flatMap((one) => Object.keys(one)))];
  const hasCoils = found.some((one) => one.coil);
  const table = () => csv([columns, ...found.map((one) => columns.map((key) => one[key]))]);
  return html`<section class="card">
    <h2>${found.length} ${found.length === 1 ? "fit" : "fits"}</h2>
    ${Object.entries(failed).map(([session, why]) => html`<p class="fault">Session ${short(session)}: ${why}</p>`)}
    <div class="scroll" tabindex="0" role="region" aria-label="Fits">
      <table>
        <thead><tr><th>session</th>${hasCoils ? html`<th>coil</th>` : null}<th>hypothesis</th><th class="num">probability</th><th class="num">validation error</th><th>chain</th></tr></thead>
        <tbody>
          ${ranked.map(
            (one) => html`<tr><td>${short(one.session)}</td>${hasCoils ? html`<td>${one.coil}</td>` : null}<th scope="row">${breakable(one.hypothesis)}</th>
              <td class="num">${Number.isFinite(one.probability) ? percent(one.probability) : "–"}</td>
              <td class="num">${Number.isFinite(one.validation_rmse_T) ? size(one.validation_rmse_T, "T") : "–"}</td>
              <td>${one.is_sampled ? (one.is_converged ? "converged" : html`<strong class="warn">not converged</strong>`) : "not sampled"}</td></tr>`,
          )}
        </tbody>
      </table>
    </div>
    <button class="tool" @click=${() => download("fits.csv", table(), "text/csv")}>All parameters as CSV</button>
  </section>`;
}

// Proposed readings, with their plan.
export function proposal(design) {
  const values = [design.so_far, ...design.reached];
  const words = design.unit ? "standard deviation" : "expected log evidence";
  const { factor, unit } = design.unit ? shownIn(design.unit) : { factor: 1, unit: "" };
  const told = (value) => (design.unit ? size(value, design.unit) : value.toPrecision(3));
  return html`<section class="card">
      <h2>${capital(design.goal)}</h2>
      <p>The ${words} goes from <strong>${told(design.so_far)}</strong> to <strong>${told(design.reached.at(-1))}</strong> with ${design.reached.length} more readings.</p>
      <p><button class="main" @click=${() => download("plan.yaml", design.plan, "application/yaml")}>Download the plan (${design.reached.length} stops)</button></p>
      ${design.programmes.length
        ? html`<h3>Programmes that change the set-up</h3>
            <ul>${design.programmes.map((one) => html`<li>${capital(one.action)}: log evidence ${one.expected_log_evidence.toFixed(1)}</li>`)}</ul>`
        : null}
    </section>
    ${figure("design", "What each further reading brings", design.unit ? "" : "A log evidence of 3 is 20 to 1.",
      lines(words, [{ label: "", kind: "c0", points: values.map((value, i) => [i, factor * value]) }],
        { xLabel: "readings added", yLabel: unit ? `${words} (${unit})` : words, mark: design.unit ? null : CLEAR_LOG_EVIDENCE, width: fitting(640) }),
      () => [["readings_added", design.unit ? `sd_${design.unit}` : "expected_log_evidence"], ...values.map((value, i) => [i, value])])}`;
}

const capital = (text) => text.slice(0, 1).toUpperCase() + text.slice(1);
