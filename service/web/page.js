// The page: one map of the service, live. What it holds is in `model`; `render` shows it.
"use strict";

import { AnchorList } from "/anchors.js";
import { KeyNeeded, Refused, hasKey, pagesOf, read, readAll, useKey } from "/api.js";
import { colouring } from "/colouring.js";
import { sessionColour } from "/colours.js";
import { byId, element, lastOf, plural, press, refill, sessionOf, shortName, soon } from "/dom.js";
import { DriveChanges } from "/drives.js";
import { Watch } from "/events.js";
import { connectExports, saveSubmap } from "/exports.js";
import { Vector3 } from "/vendor/three-0.187.0/three.module.js";
import { inverse, mainFrame, matrixOf, placements, product } from "/frames.js";
import { listen } from "/keyboard.js";
import { nearMisses } from "/nearmisses.js";
import { PairView } from "/pair.js";
import { Plans } from "/plans.js";
import { actionsOf } from "/review.js";
import { MapView, roundMetres } from "/scene.js";
import { HeightSlice } from "/slice.js";
import { Tools, inWords } from "/tools.js";
import { Versions } from "/versions.js";
import { faultOf, stateOf, titleOf, verdictOf } from "/words.js";

const STATUS_EVERY_MS = 5000;
const LISTED_AT_ONCE = 120;
const RELISTED_FROM = 20;
const ASKED_WHY = 20;

const model = {
  map: null,
  maps: [],
  missing: "",
  sessions: new Map(),
  submaps: new Map(),
  loops: new Map(),
  operations: new Map(),
  faults: [],
  hidden: new Set(),
  states: new Set(["accepted", "ambiguous"]),
  search: "",
  listed: LISTED_AT_ONCE,
  rejectedRead: false,
  reading: false,
  selected: null,
  corrected: 1,
  colourBy: "session",
  status: null,
};

let view = null;
let watch = null;
let tools = null;
let versions = null;
let drives = null;
let anchors = null;
let plans = null;
let slice = null;
const pair = new PairView({
  onStep: stepPair,
  onClose: () => select(model.selected),
  onRegistered: registered,
  actionsOf: (loop) => actionsOf(loop, taken),
  startOf,
});

// ---------------------------------------------------------------------------------------------- reading

async function openMap(name) {
  // The first map counts from the request of the page.
  const began_ms = model.map ? performance.now() : 0;
  forgetMap();
  model.map = name;
  watch = new Watch(name, { onEvent: take, onState: tellConnection, onForgotten: readMap });
  await watch.opened;
  await readMap();
  if (name !== model.map) return;
  render(true);
  document.body.dataset.drawnMs = String(Math.round(performance.now() - began_ms));
}

function forgetMap() {
  byId("until").value = 1000;
  watch?.stop();
  versions?.clear();
  drives?.clear();
  anchors?.clear();
  plans?.clear();
  tools?.use("none");
  slice?.clear();
  Object.assign(model, { map: null, missing: "", rejectedRead: false, reading: false, selected: null, listed: LISTED_AT_ONCE, faults: [] });
  for (const held of [model.sessions, model.submaps, model.loops, model.operations, model.hidden]) held.clear();
}

/** Everything of the map but its rejected candidates, which are many and seldom wanted. */
async function readMap() {
  const name = model.map;
  const sessions = await readAll(`/v1/${name}/sessions`, "sessions");
  const accepted = pagesOf(`/v1/${name}/loopClosures?state=ACCEPTED`, "loop_closures");
  const [{ value: first }, ambiguous, proposed, running, failed, ...tracks] = await Promise.all([
    accepted.next(),
    readAll(`/v1/${name}/loopClosures?state=REJECTED&reason=AMBIGUOUS`, "loop_closures"),
    readAll(`/v1/${name}/loopClosures?state=PROPOSED`, "loop_closures"),
    readAll("/v1/operations?state=RUNNING", "operations"),
    readAll("/v1/operations?state=FAILED", "operations"),
    ...sessions.map((session) => readAll(`/v1/${session.name}/submaps`, "submaps")),
  ]);
  if (name !== model.map) return;
  for (const session of sessions) model.sessions.set(session.name, session);
  for (const submap of tracks.flat()) model.submaps.set(submap.name, submap);
  for (const loop of [...first.items, ...ambiguous, ...proposed]) model.loops.set(loop.name, loop);
  for (const operation of [...running, ...failed]) if (ofMap(operation)) model.operations.set(operation.name, operation);
  model.reading = first.more;
  if (first.more) readFurther(name, accepted).catch(tellError);
  await Promise.all([first.more || readWhyNoLoops(), readFaults(), versions.show(name), plans.show(name)]);
  drives.show(versions.inForce);
  anchors.show(versions.inForce);
  if (model.states.has("rejected")) await readRejected();
}

/** The further pages of accepted loops: the first picture waits for none of them. */
async function readFurther(name, pages) {
  try {
    for await (const { items } of pages) {
      if (name !== model.map) return;
      for (const loop of items) model.loops.set(loop.name, loop);
      tellReading(model.loops.size);
    }
    await readWhyNoLoops();
  } finally {
    if (name === model.map) model.reading = false;
  }
  if (name === model.map) render();
}

function tellReading(count) {
  byId("listed").textContent = `reading ${count.toLocaleString("en")}`;
}

/** Why a session has no loop is told of the session itself, not in the list of all. */
async function readWhyNoLoops() {
  const without = [...model.sessions.values()].filter((session) => session.state === "FINISHED" && !hasLoop(session.name)).slice(0, ASKED_WHY);
  for (const session of await Promise.all(without.map(({ name }) => read(`/v1/${name}`)))) model.sessions.set(session.name, session);
}

function hasLoop(name) {
  return [...model.loops.values()].some((loop) => loop.state === "ACCEPTED" && [loop.query, loop.match].some((end) => sessionOf(end) === name));
}

/** Why none of a session's submaps has a loop, in words; empty where one has, or where that is not known yet. */
function whyNoLoops(session) {
  return hasLoop(session.name) ? "" : (session.no_loops?.message ?? "");
}

/** The faults of odometry that the version in force has mended. */
async function readFaults() {
  const [name, version] = [model.map, versionShown()];
  const told = version ? await read(`/v1/${name}/versions/${version}`).catch(() => null) : null;
  if (name === model.map) model.faults = told?.summary.odometry_faults ?? [];
}

async function readRejected() {
  if (model.rejectedRead) return;
  model.rejectedRead = true;
  const name = model.map;
  const loops = await readAll(`/v1/${name}/loopClosures?state=REJECTED`, "loop_closures", tellReading);
  if (name === model.map) for (const loop of loops) model.loops.set(loop.name, loop);
}

const ofMap = (operation) => operation.subject === model.map || operation.subject.startsWith(`${model.map}/`);

// ---------------------------------------------------------------------------------------------- live

const stale = new Set();

function take(event) {
  if (event.kind === "LOOP_CLOSURE") model.loops.set(event.loop_closure.name, event.loop_closure);
  if (event.kind === "OPERATION") {
    model.operations.set(event.operation.name, event.operation);
    if (event.operation.subject.includes("/submaps/")) stale.add(event.operation.subject);
  }
  // With a new version of the map every submap may lie elsewhere.
  if (event.kind === "ANCHOR") judgedAgain();
  if (event.kind === "MAP_VERSION") readMap().then(renderSoon, tellError);
  catchUp();
  renderSoon();
}

const judgedAgain = soon(() => anchors.changed(), 250);

const catchUp = soon(async () => {
  const names = [...stale];
  stale.clear();
  const sessions = new Set(names.map(sessionOf));
  const lists = names.length >= RELISTED_FROM ? [...sessions].map((name) => readAll(`/v1/${name}/submaps`, "submaps")) : names.map(async (name) => [await read(`/v1/${name}`)]);
  const told = [...lists, ...[...sessions].map(async (name) => [await read(`/v1/${name}`)])];
  for (const result of await Promise.allSettled(told)) {
    for (const item of result.value ?? []) (item.name.includes("/submaps/") ? model.submaps : model.sessions).set(item.name, item);
  }
  renderSoon();
}, 250);

function tellConnection(state) {
  const lost = state === "lost";
  document.body.dataset.live = String(!lost);
  showBanner(lost ? "The connection to the service is lost; trying again" : "");
}

// ---------------------------------------------------------------------------------------------- drawing

const renderSoon = soon(() => render());

function visibleLoops() {
  const wanted = model.search.toLowerCase().split(/\s+/).filter(Boolean);
  return [...model.loops.values()].filter((loop) => {
    if (!model.states.has(stateOf(loop))) return false;
    if (model.hidden.has(sessionOf(loop.query)) || model.hidden.has(sessionOf(loop.match))) return false;
    const text = `${shortName(loop.query)} ${shortName(loop.match)} ${verdictOf(loop)} ${loop.reason ?? ""} ${lastOf(loop.name)}`.toLowerCase();
    return wanted.every((word) => text.includes(word));
  });
}

function tracks() {
  const bySession = Map.groupBy(model.submaps.values(), (submap) => sessionOf(submap.name));
  return [...model.sessions.values()].map((session, index) => ({
    name: session.name,
    colour: sessionColour(index),
    submaps: (bySession.get(session.name) ?? []).sort((a, b) => a.ordinal - b.ordinal),
  }));
}

function render(refit = false) {
  const loops = visibleLoops();
  renderSessions();
  renderLoops(loops);
  renderWork();
  renderFigures();
  renderStage(loops, refit);
  renderSelection();
}

/** The time of a submap, milliseconds since 1970. */
const msOf = (submap) => Number(submap.stamp_ns) / 1e6;

/** The time up to which submaps are drawn, milliseconds since 1970; Infinity where all are. */
function untilMs() {
  const times = [...model.submaps.values()].map(msOf);
  const [first, last] = times.reduce(([low, high], at) => [Math.min(low, at), Math.max(high, at)], [Infinity, -Infinity]);
  byId("time").hidden = !(last > first);
  const share = Number(byId("until").value) / 1000;
  return share < 1 && last > first ? first + share * (last - first) : Infinity;
}

function renderStage(loops, refit) {
  const [until, known] = [untilMs(), tracks()];
  const every = known.map((track) => ({ ...track, submaps: track.submaps.filter((submap) => msOf(submap) <= until) }));
  const submaps = model.submaps.size;
  model.frame = mainFrame(model.submaps.values());
  model.placed = placements(known, [...model.loops.values()].filter((loop) => loop.state === "ACCEPTED"), model.frame);
  const drawn = every.filter((track) => model.placed.has(track.name) && !model.hidden.has(track.name));
  byId("frames").hidden = model.frame === null;
  tellCaption(every, drawn, until);
  if (view) {
    if (refit) view.places.clear();
    view.show({
      tracks: drawn.map((track) => ({ ...track, T_drawing_odom: model.placed.get(track.name) })),
      loops: loops.map((loop) => ({ loop, state: stateOf(loop) })),
      lift: liftPerSubmap(),
      frame: model.frame,
      corrected: model.corrected,
      faults: model.faults,
      colouringOf: colouringNow,
    });
    renderFaults();
    anchors?.draw();
    plans?.draw();
    tellLegend(view.colouring);
    slice?.refresh();
  }
  Object.assign(document.body.dataset, { submaps, drawnSubmaps: view?.places.size ?? 0, drawnLoops: view?.drawnLoops ?? 0, listedLoops: loops.length });
  tellEmpty(submaps);
}

/** The colouring that is asked for; the same object as long as it says the same, so that clouds are not made anew. */
function colouringNow() {
  const submaps = [...view.places.values()].map(({ submap }) => submap);
  if (!submaps.length) return null;
  const made = colouring(model.colourBy, submaps, [...model.loops.values()], model.frame, (name) => view.heightOf(name));
  const said = made && JSON.stringify([model.colourBy, made.low, made.high, submaps.length]);
  if (said !== model.colouredAs) Object.assign(model, { colouredAs: said, colouring: made });
  return model.colouring ?? null;
}

function tellLegend(shown) {
  byId("legend").hidden = !shown || shown.attribute === "color";
  if (!shown) return;
  byId("legend").title = shown.title;
  [byId("legend-low").textContent, byId("legend-high").textContent] = shown.legend;
}

/** A word at each fault of odometry that is drawn; it moves with the camera. */
function renderFaults() {
  byId("faults").replaceChildren(
    ...view.faultMarks.map(({ fault }) => element("li", { title: `${lastOf(fault.session)}: ${fault.message}` }, `${lastOf(fault.session)}: ${faultOf(fault)}`)),
  );
  document.body.dataset.drawnFaults = String(view.faultMarks.length);
  placeFaults(view);
}

function placeFaults(of) {
  [...byId("faults").children].forEach((label, index) => {
    const at = of.project(of.faultMarks[index].at);
    label.hidden = at.hidden;
    label.style.left = `${Math.round(at.x)}px`;
    label.style.top = `${Math.round(at.y)}px`;
  });
}

function liftPerSubmap() {
  const share = Number(byId("lift").value) / 100;
  if (!share || !view) return 0;
  const size = [...model.submaps.values()].reduce((most, { position_m: p }) => Math.max(most, Math.abs(p.x), Math.abs(p.y)), 10);
  return (share * share * 2.5 * size) / Math.max(20, model.submaps.size);
}

/** How much of the stage its tools cover at the top and at the bottom, pixels. */
function coveredByTools() {
  const stage = byId("view").getBoundingClientRect();
  const [above, below] = [".stage > .tools", ".stage > .foot"].map((part) => document.querySelector(part).getBoundingClientRect());
  return { top: Math.max(0, above.bottom - stage.top), bottom: Math.max(0, stage.bottom - below.top) };
}

function tellCaption(every, drawn, until) {
  const apart = every.filter((track) => track.submaps.length && !model.placed.has(track.name) && !model.hidden.has(track.name));
  const said = [`${plural(drawn.length, "session")}, ${plural(drawn.reduce((sum, track) => sum + track.submaps.length, 0), "submap")}`];
  if (until !== Infinity) said.push(`until ${new Date(until).toISOString().slice(0, 19).replace("T", " ")} UTC`);
  const corrected = model.frame !== null && model.corrected > 0.5;
  if (corrected) said.push(`in the frame of the map, version ${versionShown()}`);
  else if (model.frame !== null) said.push(`as odometry has it: up to ${driftInWords(drawn)} off`);
  else if (drawn.length > 1) said.push("sessions placed by their best loop closure");
  if (apart.length) said.push(`${plural(apart.length, "session")} not drawn: no loop closure leads there yet`);
  const more = Object.assign(document.createElement("span"), { className: "wide" });
  if (corrected) more.textContent = `; odometry alone is up to ${driftInWords(drawn)} off`;
  byId("caption").replaceChildren(said.join(" \u00b7 "), element("span", { class: "sliced" }), more);
  tellSlice();
}

/** A slice has heights, and a lifted drawing has none. */
function sliced() {
  if (slice.isOn && Number(byId("lift").value)) {
    byId("lift").value = "0";
    renderSoon();
  }
  tellSlice();
}

function tellSlice() {
  const said = byId("caption").querySelector(".sliced");
  if (said) said.textContent = slice?.inWords() ? ` \u00b7 heights ${slice.inWords()}` : "";
}

const versionShown = () => Math.max(0, ...[...model.submaps.values()].map((submap) => Number(submap.map_version)));

/** How far odometry alone puts the worst submap from where the map has it. */
function driftInWords(drawn) {
  let most = 0;
  for (const track of drawn) {
    for (const submap of track.submaps) {
      if (!submap.t_map_submap || submap.frame !== model.frame) continue;
      const driven = product(model.placed.get(track.name), matrixOf(submap.t_odom_submap)).elements;
      const { x, y, z } = submap.t_map_submap.translation;
      most = Math.max(most, Math.hypot(driven[12] - x, driven[13] - y, driven[14] - z));
    }
  }
  return `${most.toFixed(most < 10 ? 1 : 0)} m`;
}

function tellEmpty(submaps) {
  if (model.missing) {
    showEmpty(`There is no map ${lastOf(model.missing)}`, "The address of this page names it. It was deleted, or its name is spelt otherwise: the list above has every map there is.");
  } else if (!model.maps.length) {
    showEmpty("Nothing here yet", "Stream a recording, or let the demonstration drive two simulated robots through a town.", "# a recording\nrevisit ingest DIR --map town\n\n# two simulated robots\nrevisit demo");
  } else if (!submaps) {
    showEmpty("This map has no submaps yet", "A submap appears once a robot has travelled far enough (10 m by default), or when one is posted. This page shows it at once.", `revisit ingest DIR --map ${lastOf(model.map)}`);
  } else if (!view) {
    showEmpty("No 3D here", "This browser offers no WebGL. The lists on the left work all the same.", "");
  } else showEmpty("");
}

function showEmpty(title, text = "", command = "", locked = false) {
  byId("empty").hidden = !title;
  byId("empty-title").textContent = title;
  byId("empty-text").textContent = text;
  byId("empty-command").textContent = command;
  byId("empty-command").hidden = !command;
  byId("unlock").hidden = !locked;
}

function showBanner(text) {
  byId("banner").hidden = !text;
  byId("banner").textContent = text;
}

// ---------------------------------------------------------------------------------------------- lists

function renderSessions() {
  const rows = [...model.sessions.values()].map((session, index) => {
    const shown = !model.hidden.has(session.name);
    const box = element("input", { type: "checkbox", id: `session-${index}` });
    box.checked = shown;
    box.addEventListener("change", () => hideSession(session.name, !box.checked));
    const detail = [plural(session.submap_count, "submap")];
    if (session.travelled_m >= 1) detail.push(`${Math.round(session.travelled_m).toLocaleString("en")} m`);
    if (session.storey) detail.push(`storey ${session.storey}`);
    if (session.state === "ACTIVE") detail.push("open");
    const why = whyNoLoops(session);
    if (why) detail.push("no loop");
    const faults = model.faults.filter((fault) => fault.session === session.name);
    detail.push(...faults.map(faultOf));
    return element(
      "li",
      { colour: sessionColour(index), class: shown ? null : "off" },
      element("label", { for: `session-${index}` }, box, element("i", { class: "swatch" }), element("span", { class: "name" }, lastOf(session.name)), element("small", { title: [why, ...faults.map(({ message }) => message)].filter(Boolean).join("\n") || null }, detail.join(" \u00b7 "))),
      element("button", { type: "button", class: "link only", title: "Show this session alone", onclick: () => showAlone(session.name) }, "only"),
    );
  });
  refill(byId("sessions"), ...(rows.length ? rows : [element("li", { class: "nothing" }, "No sessions yet")]));
  byId("all-sessions").hidden = !model.hidden.size;
}

function hideSession(name, hide) {
  if (hide) model.hidden.add(name);
  else model.hidden.delete(name);
  render();
}

function showAlone(name) {
  for (const other of model.sessions.keys()) model.hidden.add(other);
  model.hidden.delete(name);
  render();
}

function renderLoops(loops) {
  const counts = Object.groupBy(model.loops.values(), stateOf);
  for (const button of byId("states").children) {
    const { state } = button.dataset;
    const known = state !== "rejected" || model.rejectedRead;
    button.querySelector("b").textContent = known ? (counts[state]?.length ?? 0).toLocaleString("en") : "";
    button.setAttribute("aria-pressed", String(model.states.has(state)));
  }
  model.order = loops.sort(newestFirst).map((loop) => loop.name);
  byId("listed").textContent = loops.length ? `${loops.length.toLocaleString("en")}, newest first` : "";
  if (model.reading) tellReading(model.loops.size);
  const rows = loops.slice(0, model.listed).map(loopRow);
  if (loops.length > model.listed) {
    rows.push(element("li", { class: "more" }, element("button", { type: "button", class: "link", onclick: showMore }, `show ${Math.min(LISTED_AT_ONCE, loops.length - model.listed)} more of ${loops.length.toLocaleString("en")}`)));
  }
  refill(byId("loops"), ...(rows.length ? rows : [element("li", { class: "nothing" }, nothingListed())]));
}

/** Of two loop closures the one that was found later comes first, else the one that was accepted later. */
const newestFirst = (a, b) => Number(b.created_at_ns) - Number(a.created_at_ns) || Number(b.number) - Number(a.number);

function nothingListed() {
  if (model.search) return "Nothing matches the search";
  const why = [...model.sessions.values()].map(whyNoLoops).find(Boolean);
  if (!model.loops.size) return why ? `No loop closure. ${why}` : "No loop closures yet: they appear when a place is seen again";
  return "None in the chosen states and sessions";
}

function showMore() {
  model.listed += LISTED_AT_ONCE;
  renderSoon();
}

function loopRow(loop) {
  const state = stateOf(loop);
  const within = sessionOf(loop.query) === sessionOf(loop.match);
  const nameOf = (submap) => [element("em", {}, lastOf(sessionOf(submap))), ` ${lastOf(submap)}`];
  // Each end is kept on one line: where both do not fit, the second one begins a line.
  const pairText = [element("span", { class: "end" }, ...nameOf(loop.query)), " ", element("span", { class: "end" }, "\u2192 ", ...(within ? [lastOf(loop.match)] : nameOf(loop.match)))];
  return element(
    "li",
    { "data-name": loop.name, class: loop.name === model.selected?.loop ? "chosen" : null },
    element(
      "button",
      { type: "button", onclick: () => openPair(loop.name), onmouseenter: () => view?.mark([loop.query, loop.match], loop), onmouseleave: () => renderSelection() },
      element("i", { class: `sign ${state}` }),
      element("span", { class: "pair-names" }, ...pairText),
      element("small", {}, state === "accepted" ? `score ${loop.score.toFixed(2)} \u00b7 overlap ${Math.round(100 * (loop.evidence?.measurement?.overlap ?? 0))} %` : verdictOf(loop)),
    ),
  );
}

function renderWork() {
  const submaps = [...model.submaps.values()];
  const waiting = submaps.filter((submap) => submap.state === "QUEUED").length;
  const failed = submaps.filter((submap) => submap.state === "FAILED");
  const others = [...model.operations.values()].filter((operation) => !operation.subject.includes("/submaps/"));
  const busy = others.filter((operation) => ["QUEUED", "RUNNING"].includes(operation.state));
  byId("work").hidden = !waiting && !failed.length && !others.length;
  byId("work-count").textContent = waiting ? `${waiting.toLocaleString("en")} of ${submaps.length.toLocaleString("en")} submaps wait` : busy.length ? plural(busy.length, "operation") : "";
  byId("progress").hidden = !waiting;
  byId("progress").value = submaps.length ? 1 - waiting / submaps.length : 0;
  const running = [...model.operations.values()].filter((operation) => operation.state === "RUNNING" && operation.subject.includes("/submaps/"));
  byId("operations").replaceChildren(
    ...others.slice(-6).map((operation) => workRow(operation.kind.toLowerCase().replaceAll("_", " "), operation.state.toLowerCase(), operation.state === "FAILED")),
    ...(waiting ? running.slice(0, 4) : []).map((operation) => workRow(shortName(operation.subject), "is being described")),
    ...failed.slice(0, 20).map((submap) => workRow(shortName(submap.name), submap.failure ? submap.failure.message : "failed", true, submap.name)),
  );
}

function workRow(title, detail, bad = false, submap = null) {
  const row = element("li", { class: bad ? "bad" : null }, element("span", {}, title), element("small", {}, detail));
  if (submap) row.addEventListener("click", () => select({ submap }));
  return row;
}

function renderFigures() {
  const accepted = [...model.loops.values()].filter((loop) => loop.state === "ACCEPTED").length;
  const rows = [["submaps", model.submaps.size], ["loop closures", accepted]];
  byId("figures").replaceChildren(...rows.map(([term, value]) => element("div", {}, element("dd", {}, value.toLocaleString("en")), element("dt", {}, term))));
}

// ---------------------------------------------------------------------------------------------- selection

function select(what) {
  model.selected = what;
  renderSelection();
  for (const row of byId("loops").children) row.classList.toggle("chosen", row.dataset.name === what?.loop);
}

function renderSelection() {
  const { submap, loop } = model.selected ?? {};
  const chosen = loop && model.loops.get(loop);
  document.body.dataset.selected = loop ?? submap ?? "";
  if (chosen) view?.mark([chosen.query, chosen.match], chosen);
  else view?.mark(submap ? [submap] : []);
  showCard(submap && model.submaps.get(submap));
}

function showCard(submap) {
  byId("card").hidden = !submap;
  if (!submap) return;
  const loops = [...model.loops.values()].filter((loop) => loop.state === "ACCEPTED" && [loop.query, loop.match].includes(submap.name));
  const { x, y, z } = submap.position_m;
  const rows = [
    ["State", submap.state.toLowerCase()],
    ["Points", submap.point_count.toLocaleString("en")],
    ["Odometry", `${x.toFixed(1)}, ${y.toFixed(1)}, ${z.toFixed(1)} m`],
    ["Taken", new Date(Number(submap.stamp_ns) / 1e6).toLocaleString()],
    submap.neural_map_bytes ? ["Neural map", `${Math.round(submap.neural_map_bytes / 1024).toLocaleString("en")} KiB`] : null,
    submap.flags?.length ? ["Flags", submap.flags.join(", ").toLowerCase().replaceAll("_", " ")] : null,
    submap.failure ? ["Failure", `${submap.failure.reason}: ${submap.failure.message}`] : null,
  ].filter(Boolean);
  byId("card").replaceChildren(
    element("header", {}, element("h2", {}, shortName(submap.name)), element("button", { type: "button", class: "link", onclick: () => select(null) }, "close")),
    element("dl", {}, ...rows.flatMap(([term, value]) => [element("dt", {}, term), element("dd", {}, value)])),
    submap.state === "DESCRIBED" && element("p", { class: "buttons" }, ...["ply", "glb"].map((format) => element("button", { type: "button", title: format === "ply" ? "Its points" : "Its surface", onclick: saveAs(submap.name, format) }, format.toUpperCase())), element("button", { type: "button", id: "explain", onclick: () => explain(submap.name) }, "Why no more?")),
    element("h3", {}, loops.length ? plural(loops.length, "loop closure") : "No accepted loop closure"),
    element("ul", { class: "loops" }, ...loops.slice(0, 12).map(loopRow)),
    element("h3", { id: "missed-title", hidden: true }, "Came near"),
    element("ul", { class: "loops", id: "missed" }),
  );
}

const saveAs = (submap, format) => async ({ target }) => {
  target.disabled = true;
  await saveSubmap(submap, format).catch((error) => showBanner(inWords(error)));
  target.disabled = false;
};

/** The pairs of a submap that came nearest to a loop closure, and what stopped each. */
async function explain(submap) {
  byId("missed-title").hidden = false;
  byId("missed").replaceChildren(element("li", { class: "nothing" }, "asking"));
  await readRejected().catch(tellError);
  byId("missed")?.replaceChildren(...nearMisses(submap, [...model.loops.values()], openPair));
}

/** Where the frames that are drawn put the query in the match's frame, before this loop closure; null where they do not. */
function beforeOf(loop) {
  const [query, match] = [model.submaps.get(loop.query), model.submaps.get(loop.match)];
  const [of_query, of_match] = [sessionOf(loop.query), sessionOf(loop.match)];
  if (!query || !match) return null;
  const [T_q, T_m] = [matrixOf(query.t_odom_submap), matrixOf(match.t_odom_submap)];
  return of_query === of_match ? product(inverse(T_m), T_q) : null;
}

/** How two submaps lie to each other as they are drawn, else side by side as odometry turns them; and what is up in the match. */
function startOf(query, match) {
  const [T_q, T_m] = [query, match].map((name) => matrixOf(model.submaps.get(name)?.t_odom_submap));
  const turned = product(inverse(T_m), T_q).setPosition(0, 0, 0);
  const up = new Vector3(0, 0, 1).transformDirection(inverse(T_m));
  return { T_match_query: view?.relative(match, query) ?? turned, up };
}

/** A loop closure was registered from where a person put its query. */
function registered(loop, isOpen) {
  model.loops.set(loop.name, loop);
  render();
  if (isOpen) openPair(loop.name);
}

function openPair(name) {
  const loop = model.loops.get(name);
  if (!loop) return;
  select({ loop: name });
  const at = (model.order ?? []).indexOf(name);
  pair.open(loop, beforeOf(loop), at < 0 ? "" : `${at + 1} of ${model.order.length}`);
}

/** The next loop closure of the list, or the previous one. */
function stepPair(by) {
  if (pair.hand.isOn) return;
  const order = model.order ?? [];
  const at = order.indexOf(model.selected?.loop);
  const next = order[at < 0 ? 0 : (at + by + order.length) % order.length];
  if (!next) return;
  if (pair.isOpen) openPair(next);
  else {
    select({ loop: next });
    byId("loops").querySelector(".chosen button")?.focus(); // which scrolls there
  }
}

/** A loop closure was reviewed: show it as the service has it now. */
function taken(loop) {
  model.loops.set(loop.name, loop);
  render();
  if (pair.isOpen && model.selected?.loop === loop.name) openPair(loop.name);
}

/** A loop closure was made by hand: show it; the worker's verdict comes as an event. */
function joined(loop) {
  model.loops.set(loop.name, loop);
  render();
  select({ loop: loop.name });
}

// ---------------------------------------------------------------------------------------------- commands

function setStates(state) {
  if (model.states.has(state)) model.states.delete(state);
  else model.states.add(state);
  if (state === "rejected" && model.states.has(state)) readRejected().then(() => render(), tellError);
  render();
}

function setSearch(text) {
  byId("search").value = model.search = text;
  model.listed = LISTED_AT_ONCE;
  renderSoon();
}

/** Put the tool away, or close what was chosen, or show every height; else end the search. */
function stepBack() {
  if (tools?.isOn) tools.use("none");
  else if (model.selected) select(null);
  else if (slice?.isOn) slice.use(false);
  else setSearch("");
}

function setSurface(surface) {
  press(byId("surface"), "surface", surface);
  view?.showSurface(surface);
  view?.draw();
}

function setView(name) {
  view?.fit(name);
  if (name !== "fit") press(byId("camera"), "view", name);
}

const FRAMES_MS = 900;

/** Move from odometry to the frame of the map, or back, so that one sees what the loop closures have done. */
function setFrames(moment, atOnce = false) {
  if (plans?.draft && moment === "before") return; // a plan is pinned to the frame of the map
  press(byId("frames"), "frames", moment);
  const [from, to, began_ms] = [model.corrected, moment === "after" ? 1 : 0, performance.now()];
  const still = atOnce || window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const step = (now_ms) => {
    const done = still ? 1 : Math.min(1, Math.max(0, (now_ms - began_ms) / FRAMES_MS));
    model.corrected = from + (to - from) * done * done * (3 - 2 * done);
    renderStage(visibleLoops(), false);
    renderSelection();
    if (done < 1) requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

function switchTheme() {
  const dark = document.documentElement.dataset.theme ?? (window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  document.documentElement.dataset.theme = dark === "dark" ? "light" : "dark";
  localStorage.setItem("revisit-theme", document.documentElement.dataset.theme);
  view?.retint();
  pair.paint();
}

/** The map, not odometry, from above, with points where nothing else is shown: so corners are found, where the map has them. */
function lookDown() {
  if (model.frame !== null) setFrames("after", true);
  setView("top");
  if (view.surface === "none") setSurface("points");
}

/** The height at which a plan of a storey, or of none, is drawn: that of its lowest submap. */
function floorOf(storey) {
  const [own, all] = [[], []];
  for (const { at, submap } of view.places.values()) {
    all.push(at.z);
    if (storey && model.sessions.get(sessionOf(submap.name))?.storey === storey) own.push(at.z);
  }
  return (own.length ? own : all).reduce((least, z) => Math.min(least, z), Infinity);
}

/** With the keyboard, which goes on to the handles. */
function cutOut() {
  if (!view) return;
  slice.use(!slice.isOn);
  if (slice.isOn) byId("slice-low").focus();
}

const toggle = (current, other) => (byId("surface").querySelector("[aria-pressed=true]").dataset.surface === current ? setSurface(other) : setSurface(current));

listen(
  [
    [["/"], "search loop closures", () => byId("search").focus()],
    [["j"], "next loop closure", () => stepPair(1), true],
    [["k"], "previous loop closure", () => stepPair(-1), true],
    [["Enter"], "open the chosen loop closure", () => model.selected?.loop && openPair(model.selected.loop)],
    [["b"], "before or after the loop closure", () => pair.slideTo(pair.share > 0.5 ? 0 : 1), true],
    [["v"], "keypoints of the loop closure, from above", () => pair.showSurface(pair.fromAbove ? "points" : "keypoints"), true],
    [["h"], "move the query of an open loop closure by hand", () => pair.isOpen && pair.switchHand(), true],
    [["t"], "look from above", () => setView("top")],
    [["p"], "look tilted", () => setView("tilted")],
    [["f"], "show everything", () => setView("fit")],
    [["o"], "odometry, or the frame of the map", () => model.frame !== null && setFrames(model.corrected > 0.5 ? "before" : "after")],
    [["s"], "points of the submaps", () => toggle("points", "none")],
    [["m"], "surfaces of the submaps", () => toggle("mesh", "none")],
    [["e"], "measure between two points", () => tools?.use(tools.tool === "measure" ? "none" : "measure")],
    [["l"], "join two submaps by hand", () => tools?.use(tools.tool === "join" ? "none" : "join")],
    [["c"], "cut out a slice between two heights", cutOut],
    [["1"], "accepted loop closures", () => setStates("accepted")],
    [["2"], "ambiguous loop closures", () => setStates("ambiguous")],
    [["3"], "rejected loop closures", () => setStates("rejected")],
    [["d"], "light or dark", switchTheme, true],
    [["?"], "this list", () => byId("help").showModal()],
    [["Escape"], "close, choose nothing, end the search", stepBack],
  ],
  () => pair.isOpen || byId("help").open || byId("plan-dialog").open,
);

// ---------------------------------------------------------------------------------------------- start

function tellHealth(readiness, status) {
  const jobs = Number(status.queued_jobs) + Number(status.running_jobs);
  const [text, mood] = !readiness.ready
    ? [readiness.reasons.join(", "), "bad"]
    : readiness.degraded?.length
      ? [readiness.degraded[0].split(":")[0], "bad"]
      : !status.workers.length
        ? ["waiting for a worker", "bad"]
        : jobs
          ? [`working on ${jobs.toLocaleString("en")}`, "busy"]
          : ["ready", "good"];
  byId("health").textContent = text;
  byId("health").className = `health ${mood}`;
  byId("health").title = `${(readiness.degraded ?? []).join("; ")}${readiness.degraded?.length ? "\n" : ""}Revisit ${status.version}, models ${status.model_version || "not loaded yet"}`;
}

async function refreshStatus() {
  const [readiness, status] = await Promise.all([read("/readyz"), read("/v1/status")]);
  tellHealth(readiness, status);
  const maps = await readAll("/v1/maps", "maps");
  const known = model.maps.map((map) => map.name).join();
  model.maps = maps;
  if (maps.map((map) => map.name).join() !== known) await chooseMap();
  else if (!maps.length) tellEmpty(0);
}

/** The map that the address names: `/#maps/town`, `/#town` or `/?map=town`. */
function mapOfAddress() {
  const name = decoded(location.hash.slice(1)) || new URLSearchParams(location.search).get("map") || "";
  return !name || name.startsWith("maps/") ? name : `maps/${name}`;
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** Show the map that the address names; where it names none, the one that is shown, or the newest. */
async function chooseMap() {
  const select = byId("map");
  const known = (name) => model.maps.some((map) => map.name === name);
  const asked = mapOfAddress();
  const chosen = asked || (known(model.map) ? model.map : model.maps.at(-1)?.name);
  select.replaceChildren(
    ...model.maps.map((map) => element("option", { value: map.name }, titleOf(map))),
  );
  select.disabled = !model.maps.length;
  select.value = chosen ?? "";
  if (!chosen || !known(chosen)) {
    forgetMap();
    model.missing = model.maps.length ? asked : "";
    return render(true);
  }
  if (chosen !== model.map) await openMap(chosen);
}

/** The address was changed by hand, by a link, or back in the history. */
async function followAddress() {
  model.maps = await readAll("/v1/maps", "maps");
  await chooseMap();
}

function tellError(error) {
  const locked = error instanceof KeyNeeded;
  byId("health").textContent = locked ? "locked" : "no answer";
  byId("health").className = "health bad";
  if (locked) {
    model.maps = [];
    showBanner("");
    showEmpty(hasKey() ? "This key does not open it" : "An API key is needed", hasKey() ? error.message : "This service lets nobody read without a key. It is kept by this tab alone, until you close it.", hasKey() ? "" : "revisit keys create --scope query", true);
  } else if (error instanceof Refused && error.status === 403) {
    model.maps = [];
    showEmpty("The service refuses", error.message, "", true);
  } else if (error instanceof Refused) showBanner(`${error.message}; trying again`);
  else showBanner("The service does not answer; trying again");
}

async function run() {
  if (!document.hidden) {
    try {
      await refreshStatus();
      if (document.body.dataset.live !== "false") showBanner("");
    } catch (error) {
      tellError(error);
    }
  }
  setTimeout(run, STATUS_EVERY_MS);
}

function connect() {
  byId("map").addEventListener("change", ({ target }) => {
    history.replaceState(null, "", `#${target.value}`);
    openMap(target.value).catch(tellError);
  });
  byId("unlock").addEventListener("submit", (event) => {
    event.preventDefault();
    useKey(byId("api-key").value);
    byId("api-key").value = "";
    refreshStatus().catch(tellError);
  });
  byId("all-sessions").addEventListener("click", () => {
    model.hidden.clear();
    render();
  });
  byId("states").addEventListener("click", ({ target }) => {
    const button = target.closest("button");
    if (button) setStates(button.dataset.state);
  });
  byId("search").addEventListener("input", ({ target }) => setSearch(target.value));
  byId("search").addEventListener("keydown", ({ key }) => key === "Escape" && setSearch(""));
  window.addEventListener("hashchange", () => followAddress().catch(tellError));
  byId("surface").addEventListener("click", ({ target }) => target.dataset.surface && setSurface(target.dataset.surface));
  byId("camera").addEventListener("click", ({ target }) => target.dataset.view && setView(target.dataset.view));
  byId("frames").addEventListener("click", ({ target }) => target.dataset.frames && setFrames(target.dataset.frames));
  byId("lift").addEventListener("input", () => {
    slice?.use(false);
    renderSoon();
  });
  byId("until").addEventListener("input", renderSoon);
  byId("colour-by").addEventListener("change", ({ target }) => {
    model.colourBy = target.value;
    render();
    if (model.colourBy === "intensity" && view.surface !== "points") setSurface("points");
  });
  connectExports(() => ({ map: model.map, submaps: [...model.submaps.values()], loops: visibleLoops(), frame: model.frame }));
  byId("theme").addEventListener("click", switchTheme);
  byId("keys").addEventListener("click", () => byId("help").showModal());
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view?.retint());
}

function connectStage() {
  const canvas = byId("view");
  let pressed = null;
  let still = false;
  canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  canvas.addEventListener("pointermove", (event) => tellPointed(event));
  canvas.addEventListener("pointerleave", () => (byId("tip").hidden = true));
  canvas.addEventListener("pointerup", (event) => {
    still = pressed !== null && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4;
    if (!still && view.surface !== "none") view.showSurface(view.surface);
  });
  // Not earlier: the click that ends a touch would go to the card that appears under the finger.
  canvas.addEventListener("click", (event) => {
    if (!still) return;
    if (tools.isOn) return tools.take(event.offsetX, event.offsetY);
    const found = view.nearest(event.offsetX, event.offsetY);
    if (found?.loop) openPair(found.loop.name);
    else select(found ? { submap: found.submap.name } : null);
  });
}

function tellPointed(event) {
  const found = event.buttons ? null : view.nearest(event.offsetX, event.offsetY);
  const tip = byId("tip");
  tip.hidden = !found;
  byId("view").classList.toggle("over", Boolean(found));
  if (!found) return;
  tip.textContent = found.loop ? `${verdictOf(found.loop)}: ${shortName(found.loop.query)} \u2192 ${shortName(found.loop.match)}` : shortName(found.submap.name);
  tip.style.left = `${Math.min(event.offsetX + 14, byId("view").clientWidth - 260)}px`;
  tip.style.top = `${event.offsetY + 14}px`;
}

function tellScale(of) {
  const scale = byId("scale");
  const metres = roundMetres(of.metresOf(70));
  scale.hidden = !of.places.size;
  scale.firstElementChild.textContent = metres >= 1000 ? `${metres / 1000} km` : `${metres} m`;
  scale.style.width = `${Math.round((70 * metres) / of.metresOf(70))}px`;
}

try {
  view = new MapView(byId("view"), (of) => {
    tellScale(of);
    placeFaults(of);
  });
  view.covered = coveredByTools;
  view.onSurface = () => slice.refresh();
  connectStage();
} catch {
  byId("view").hidden = true;
  byId("tools").hidden = true;
}
versions = new Versions({ view, onChanged: () => readMap().then(renderSoon, tellError) });
drives = new DriveChanges({ view, frame: () => model.frame });
anchors = new AnchorList({
  view,
  sessions: () => [...model.sessions.keys()],
  submaps: () => [...model.submaps.values()],
  frame: () => model.frame,
});
tools = new Tools({
  view,
  mapName: () => model.map,
  notDrawn: () => [...model.submaps.values()].filter(({ name }) => !model.placed.has(sessionOf(name))),
  onJoined: joined,
  onMove: (query, match) => pair.openByHand(query, match),
});
slice = new HeightSlice({ view, onChanged: sliced });
plans = new Plans({ view, tools, frame: () => model.frame, heightOf: floorOf, lookDown });
connect();
run();

/** For tests: where a submap is drawn, and what is drawn. */
globalThis.revisitPage = { model, whereIs: (name) => view?.whereIs(name), view: () => view, slice: () => slice, openPair, select, pair, render };
