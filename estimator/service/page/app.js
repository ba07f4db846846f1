// The page: who is logged in, which view the address asks for, and drawing it anew when something has changed.

import { html, render } from "./vendor/lit-html.js";
import { ask, get, login, Problem } from "./api.js";
import { HistoryView } from "./history.js";
import { JobView } from "./job.js";
import { JobsView } from "./jobs.js";
import { LiveView } from "./live.js";
import { NewJobView } from "./newjob.js";
import { RigsView } from "./rigs.js";
import { SessionsView } from "./sessions.js";
import { WhatIfView } from "./whatif.js";

const TABS = [
  ["rigs", "Rigs", RigsView],
  ["sessions", "Sessions", SessionsView],
  ["jobs", "Jobs", JobsView],
];
const OF_ONE = { history: HistoryView, jobs: JobView, live: LiveView, new: NewJobView, "what-if": WhatIfView };

let state = null;
let view = null;
let fault = null;
let isAsked = false; // for a login
let isPlanned = false;

function update() {
  if (isPlanned) return;
  isPlanned = true;
  requestAnimationFrame(() => {
    isPlanned = false;
    render(page(), document.getElementById("app"));
  });
}

function page() {
  const [tab] = parts();
  return html`<a class="skip" href="#main" @click=${skip}>Skip to content</a>
    <header>
      <a class="name" href="#/rigs">coilcal</a>
      <nav aria-label="Main">
        ${TABS.map(
          ([key, name]) => html`<a href="#/${key}" aria-current=${key === tab ? "page" : "false"}>${name}</a>`,
        )}
      </nav>
      <span class="who">${who()}</span>
    </header>
    <main id="main" tabindex="-1">
      ${isAsked ? loginForm() : fault ? html`<p class="fault" role="alert">${fault}</p>` : view?.template()}
    </main>`;
}

function who() {
  if (!state || isAsked) return null;
  if (state.user === "local") return "this computer";
  return html`${state.user} (${state.scope}) <button class="tool" @click=${logOut}>Log out</button>`;
}

function skip(event) {
  event.preventDefault();
  document.getElementById("main").focus();
}

function loginForm() {
  const send = async (event) => {
    event.preventDefault();
    try {
      await ask("POST", "/v1/login", { body: { token: event.target.elements.token.value } });
      [isAsked, fault] = [false, null];
      await begin();
    } catch (error) {
      fault = error.message;
    }
    update();
  };
  return html`<form class="login card" @submit=${send}>
    <h1>Log in</h1>
    <p>With a token that <code>coilcal serve token create</code> has made.</p>
    <label>Token <input name="token" type="password" autocomplete="current-password" required autofocus /></label>
    ${fault ? html`<p class="fault" role="alert">${fault}</p>` : null}
    <button class="main">Log in</button>
  </form>`;
}

async function logOut() {
  await ask("POST", "/v1/logout");
  location.reload();
}

const parts = () => location.hash.replace(/^#\//, "").split("/");

async function go() {
  view?.close?.();
  const [tab, id, more] = parts();
  const Kind = id ? OF_ONE[tab] : TABS.find(([key]) => key === tab)?.[2];
  if (!Kind) {
    location.hash = "#/rigs";
    return;
  }
  fault = null;
  const mine = new Kind(update, id, more);
  view = mine;
  document.title = `coilcal: ${mine.title}`;
  update();
  try {
    await mine.load();
  } catch (error) {
    if (view === mine) tell(error);
  }
  update();
}

function tell(error) {
  if (!(error instanceof Problem)) throw error;
  if (error.status !== 401) fault = error.message;
}

login.addEventListener("needed", () => {
  isAsked = true;
  update();
});

// What an action of a view could not do, said where the user looks.
window.addEventListener("unhandledrejection", (event) => {
  if (!(event.reason instanceof Problem)) return;
  event.preventDefault();
  if (event.reason.status === 401) return;
  fault = event.reason.message;
  update();
});

async function begin() {
  state = await get("/v1/state");
  await go();
}

window.addEventListener("resize", update);
window.addEventListener("hashchange", () => {
  go();
  document.getElementById("main")?.focus();
});
update();
begin().catch((error) => {
  tell(error);
  update();
});
