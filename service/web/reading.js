// What the page asks the service for. Everything goes through GET /v1; nothing is ever changed from here.
"use strict";

const PAGE_SIZE = 500;
const MOST_PAGES = 20;

const KEY = "revisit-api-key";

/** The service lets nobody read without a key, or not with this one. */
export class KeyNeeded extends Error {}

/** Use this API key from now on, until the tab is closed. */
export function useKey(key) {
  sessionStorage.setItem(KEY, key.trim());
}

export async function read(path) {
  const key = sessionStorage.getItem(KEY);
  const headers = { accept: "application/json", ...(key ? { authorization: `Bearer ${key}` } : {}) };
  const answer = await fetch(path, { headers, cache: "no-store" });
  if (answer.status === 503 && path === "/readyz") return answer.json();
  if (answer.status === 401 || answer.status === 403) throw new KeyNeeded((await answer.json()).detail);
  if (!answer.ok) throw new Error(`${path} answered ${answer.status}`);
  return answer.json();
}

/** All items of a list, up to 10,000: more than a person can tell apart on a screen. */
export async function readAll(path, field) {
  const items = [];
  let token = "";
  for (let page = 0; page < MOST_PAGES; page += 1) {
    const separator = path.includes("?") ? "&" : "?";
    const answer = await read(`${path}${separator}page_size=${PAGE_SIZE}&page_token=${encodeURIComponent(token)}`);
    items.push(...answer[field]);
    token = answer.next_page_token;
    if (!token) break;
  }
  return items;
}

/** The sessions, submaps and accepted loop closures of a map. */
export async function readMap(map) {
  const sessions = await readAll(`/v1/${map}/sessions`, "sessions");
  const [loops, ...tracks] = await Promise.all([
    readAll(`/v1/${map}/loopClosures?state=ACCEPTED`, "loop_closures"),
    ...sessions.map((session) => readAll(`/v1/${session.name}/submaps`, "submaps")),
  ]);
  return { sessions, loops, tracks };
}
