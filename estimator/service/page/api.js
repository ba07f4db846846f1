// Requests to the service. A refusal is a `Problem` with the service's sentence; one for want of a login asks for it.

export class Problem extends Error {
  constructor(status, sentence) {
    super(sentence);
    this.status = status;
  }
}

export const login = new EventTarget();

export async function ask(method, path, { body, type, headers, isFile } = {}) {
  const answer = await fetch(path, {
    method,
    body: type ? body : body === undefined ? undefined : JSON.stringify(body),
    headers: { ...(body === undefined ? {} : { "Content-Type": type ?? "application/json" }), ...headers },
    credentials: "same-origin",
  }).catch(() => {
    throw new Problem(0, "The service cannot be reached.");
  });
  if (answer.ok) {
    if (isFile) {
      const name = answer.headers.get("content-disposition")?.match(/filename="([^"]+)"/)?.[1];
      return { content: await answer.blob(), name };
    }
    const kind = answer.headers.get("content-type") ?? "";
    return answer.status === 204 ? null : kind.includes("json") ? answer.json() : answer.text();
  }
  const told = await answer.json().catch(() => ({ detail: `The service answered ${answer.status}.` }));
  if (answer.status === 401 && path !== "/v1/login") login.dispatchEvent(new Event("needed"));
  throw new Problem(answer.status, told.detail);
}

export const get = (path) => ask("GET", path);
export const post = (path, body, headers) => ask("POST", path, { body, headers });

// Everything of a list, page by page, as far as a screen shows it.
export async function all(path, most = 500) {
  const items = [];
  let cursor = null;
  do {
    const url = new URL(path, location.origin);
    url.searchParams.set("limit", Math.min(most, 200));
    if (cursor) url.searchParams.set("cursor", cursor);
    const page = await get(url.pathname + url.search);
    items.push(...page.items);
    cursor = page.next;
  } while (cursor && items.length < most);
  return items;
}

// Give a text or blob to the user as a file.
export function download(name, content, type) {
  const url = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
