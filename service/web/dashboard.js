// The dashboard: asks /v1 every few seconds and shows it. Text only ever enters the page as textContent.
"use strict";

import { bestLoops, Drawing, SESSION_COLOURS } from "/drawing.js";
import { KeyNeeded, read, readAll, readMap, useKey } from "/reading.js";

const REFRESH_MS = 3000;
const MOST_LISTED = 100;
const byId = (id) => document.getElementById(id);
const drawing = new Drawing(byId("trajectory"));
let seen = "";
let shown = { sessions: [], loops: [], tracks: [] };

function element(tag, text, ...classes) {
  const made = document.createElement(tag);
  made.textContent = text;
  made.classList.add(...classes);
  return made;
}

const plural = (count, word) => `${count.toLocaleString("en")} ${word}${count === 1 ? "" : "s"}`;
const shortName = (name) => name.split("/").filter((_, index) => index % 2 === 1).slice(1).join("/");

function showHealth(text, mood) {
  const badge = byId("health");
  badge.textContent = text;
  badge.className = `health ${mood}`;
}

function judgeHealth(readiness, status) {
  if (!readiness.ready) showHealth(readiness.reasons.join(", "), "bad");
  else if (!status.workers.length) showHealth("waiting for a worker", "bad");
  else if (status.queued_jobs + status.running_jobs) showHealth("working", "busy");
  else showHealth("ready", "good");
}

function showFigures(status) {
  const rows = [
    ["queued", status.queued_jobs, false],
    ["running", status.running_jobs, false],
    ["failed", status.failed_jobs, status.failed_jobs > 0],
    ["described submaps", status.indexed_submaps, false],
    ["workers", status.workers.length, status.workers.length === 0],
  ];
  byId("figures").replaceChildren(
    ...rows.map(([term, value, alarm]) => {
      const row = document.createElement("div");
      row.append(element("dt", term), element("dd", value.toLocaleString("en"), ...(alarm ? ["alarm"] : [])));
      return row;
    }),
  );
  byId("version").textContent = `${status.version}, models ${status.model_version || "not loaded yet"}`;
}

function showMaps(maps) {
  const select = byId("map");
  // A link may name the map (`/#maps/town`); else the newest one is shown.
  const wished = [select.value, decodeURIComponent(location.hash.slice(1)), maps.at(-1)?.name];
  const chosen = wished.find((name) => maps.some((map) => map.name === name));
  select.replaceChildren(
    ...maps.map((map) => {
      const id = map.name.slice("maps/".length);
      const option = element("option", map.display_name ? `${map.display_name} (${id})` : id);
      option.value = map.name;
      return option;
    }),
  );
  select.disabled = !maps.length;
  if (chosen) select.value = chosen;
  return select.value;
}

function showList(id, rows) {
  byId(id).replaceChildren(...(rows.length ? rows : [element("li", "none", "nothing")]));
}

function listRow(title, detail, ...classes) {
  const row = element("li", title, ...classes);
  row.append(element("small", detail));
  return row;
}

function showLists({ sessions, loops, tracks }) {
  showList(
    "sessions",
    sessions.map((session, index) => {
      const detail = `${session.state.toLowerCase()}, ${Math.round(session.travelled_m)} m, ` +
        `${plural(session.submap_count, "submap")}, ${plural(Number(session.committed_seq), "scan")}`;
      return listRow(shortName(session.name), detail, "session", `colour-${index % SESSION_COLOURS.length}`);
    }),
  );
  showList(
    "loops",
    loops.slice(-MOST_LISTED).reverse().map((loop) => {
      const detail = `score ${loop.score.toFixed(2)}, similarity ${loop.similarity.toFixed(2)}`;
      const row = listRow(`${shortName(loop.query)} \u2192 ${shortName(loop.match)}`, detail);
      row.addEventListener("mouseenter", () => drawing.highlight(loop));
      row.addEventListener("mouseleave", () => drawing.highlight(null));
      return row;
    }),
  );
  const failed = tracks.flat().filter((submap) => submap.state === "FAILED");
  showList(
    "failures",
    failed.slice(-MOST_LISTED).map((submap) =>
      listRow(shortName(submap.name), submap.failure ? `${submap.failure.reason}: ${submap.failure.message}` : ""),
    ),
  );
}

function showEmpty(title, text, command) {
  byId("empty").hidden = !title;
  byId("empty-title").textContent = title;
  byId("empty-text").textContent = text;
  byId("empty-command").textContent = command;
}

function summary() {
  const submaps = shown.tracks.flat();
  const waiting = submaps.filter((submap) => submap.state === "QUEUED").length;
  return `${plural(submaps.length, "submap")}, ${plural(shown.loops.length, "loop closure")}` +
    (waiting ? `, ${waiting.toLocaleString("en")} waiting` : "");
}

function showDrawing() {
  const loops = byId("every-loop").checked ? shown.loops : bestLoops(shown.loops);
  const apart = drawing.show({ tracks: shown.tracks, loops });
  byId("message").textContent = summary();
  byId("note").textContent = "Metres, x to the right, y up, as the robots' odometry has it: drift is not corrected. " +
    "Sessions are placed by their best loop closure." +
    (apart ? ` ${plural(apart, "session")} not drawn: no loop closure leads to the first session yet.` : "");
}

async function showMap(map) {
  shown = await readMap(map);
  showLists(shown);
  showDrawing();
  if (shown.tracks.flat().length) showEmpty("", "", "");
  else {
    showEmpty(
      "This map has no submaps yet",
      "A submap appears once a robot has travelled far enough (10 m by default), or when one is posted.",
      `revisit ingest DIR --map ${map.slice("maps/".length)}`,
    );
  }
}

async function refresh() {
  try {
    const [readiness, status] = await Promise.all([read("/readyz"), read("/v1/status")]);
    byId("unlock").hidden = true;
    judgeHealth(readiness, status);
    showFigures(status);
    const maps = await readAll("/v1/maps", "maps");
    const map = showMaps(maps);
    if (!map) {
      showLists({ sessions: [], loops: [], tracks: [] });
      showEmpty(
        "Nothing here yet",
        "Stream a recording, or let the demonstration drive two simulated robots through a town.",
        "revisit ingest DIR --map town      a KITTI odometry folder\nrevisit demo                       a simulated drive",
      );
      byId("message").textContent = "No maps yet";
      return;
    }
    // Submaps and loops are read again only where something has happened since.
    const sessions = await readAll(`/v1/${map}/sessions`, "sessions");
    const now = JSON.stringify([map, sessions, status.queued_jobs, status.running_jobs, status.failed_jobs,
      status.indexed_submaps]);
    if (now === seen) return;
    await showMap(map);
    seen = now;
  } catch (error) {
    seen = "";
    const locked = error instanceof KeyNeeded;
    byId("unlock").hidden = !locked;
    showHealth(locked ? "an API key is needed" : "the service does not answer", "bad");
    byId("message").textContent = error.message;
  }
}

async function run() {
  if (!document.hidden) await refresh();
  window.setTimeout(run, REFRESH_MS);
}

function tellSubmap(event) {
  const submap = drawing.nearest(event.offsetX, event.offsetY);
  if (!submap) {
    byId("message").textContent = summary();
    return;
  }
  const { x, y } = submap.position_m;
  byId("message").textContent = `${shortName(submap.name)}: ${submap.state.toLowerCase()}, x ${x.toFixed(1)} m, ` +
    `y ${y.toFixed(1)} m, ${plural(submap.point_count, "point")}`;
}

byId("map").addEventListener("change", () => {
  history.replaceState(null, "", `#${byId("map").value}`);
  refresh();
});
byId("api-key").addEventListener("change", () => {
  useKey(byId("api-key").value);
  byId("api-key").value = "";
  refresh();
});
byId("every-loop").addEventListener("change", showDrawing);
byId("trajectory").addEventListener("mousemove", tellSubmap);
run();
