// What the page asks the service for. An API key is kept by the tab alone.
"use strict";

const ATTEMPTS = 5;
const PAGE_SIZE = 500;
const MOST_PAGES = 20;
const KEY = "revisit-api-key";

/** The service lets nobody read without a key, or not with this one. */
export class KeyNeeded extends Error {}

/** The service refused; `reason` is that of its table of errors. */
export class Refused extends Error {
  constructor(problem) {
    super(problem.detail);
    this.reason = problem.reason;
    this.status = problem.status;
  }
}

/** Use this API key from now on, until the tab is closed. */
export function useKey(key) {
  sessionStorage.setItem(KEY, key.trim());
}

export function hasKey() {
  return Boolean(sessionStorage.getItem(KEY));
}

/** The headers of a request, with the key where there is one. */
export function headers(accept) {
  const key = sessionStorage.getItem(KEY);
  return { accept, ...(key ? { authorization: `Bearer ${key}` } : {}) };
}

/** The answer to a request, whatever it says. */
async function answered(path, options) {
  try {
    return await fetch(path, options);
  } catch (error) {
    throw new Error("the service does not answer", { cause: error });
  }
}

async function checked(answer) {
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({ detail: `${answer.url} answered ${answer.status}` }));
  if (answer.status === 401) throw new KeyNeeded(problem.detail);
  throw new Refused({ ...problem, status: answer.status });
}

export async function read(path) {
  const answer = await answered(path, { headers: headers("application/json"), cache: "no-store" });
  if (answer.status === 503 && path === "/readyz") return answer.json();
  return (await checked(answer)).json();
}

/** Ask the service to do something: POST with a JSON body. */
export async function send(path, body = {}) {
  const answer = await answered(path, {
    method: "POST",
    headers: { ...headers("application/json"), "content-type": "application/json" },
    body: JSON.stringify(body),
  });
  return (await checked(answer)).json();
}

/** Ask the service to keep a file, a Blob: POST with its bytes as body. */
export async function sendFile(path, file) {
  const answer = await answered(path, { method: "POST", headers: { ...headers("application/json"), "content-type": file.type }, body: file });
  return (await checked(answer)).json();
}

/** Ask the service to delete something. */
export async function remove(path) {
  await checked(await answered(path, { method: "DELETE", headers: headers("application/json") }));
}

export async function readFile(path) {
  for (let attempt = 1; ; attempt += 1) {
    const answer = await answered(path, { headers: headers("*/*") });
    if (answer.status !== 503 || attempt === ATTEMPTS) return (await checked(answer)).arrayBuffer();
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(answer.headers.get("retry-after") ?? 2)));
  }
}

/** The pages of a list, one after another: `items`, and whether `more` follow. Of its first 10,000 items: more than a person can tell apart on a screen. */
export async function* pagesOf(path, field) {
  const separator = path.includes("?") ? "&" : "?";
  let token = "";
  for (let page = 1; page <= MOST_PAGES; page += 1) {
    const answer = await read(`${path}${separator}page_size=${PAGE_SIZE}&page_token=${encodeURIComponent(token)}`);
    token = answer.next_page_token;
    const more = Boolean(token) && page < MOST_PAGES;
    yield { items: answer[field], more };
    if (!more) return;
  }
}

/** All items of a list, as far as `pagesOf` gives them. */
export async function readAll(path, field, told = () => {}) {
  const all = [];
  for await (const { items } of pagesOf(path, field)) {
    all.push(...items);
    told(all.length);
  }
  return all;
}
