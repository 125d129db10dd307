// The anchors of the map: listed when the list is opened, those that do not hold the map first, and drawn with the way
// from where the map has each point to where the world outside says it is.
"use strict";

import { Vector3 } from "/vendor/three-0.187.0/three.module.js";

import { readAll } from "/api.js";
import { byId, element, lastOf, plural, sessionOf } from "/dom.js";
import { inverse, matrixOf, product } from "/frames.js";
import { inWords } from "/tools.js";
import { anchorReason, metres } from "/words.js";

const SHOWN = 60;
const MOST_DRAWN = 5000;
const STATES = { SET_ASIDE: "Set aside", NOT_ALIGNED: "No effect", IN_MAP: "Holds the map", STATE_UNSPECIFIED: "Not judged yet" };
const ORDER = Object.keys(STATES);

/** `view` is the MapView; `sessions()` are names, `submaps()` those of all; `frame()` is that of the map which is drawn. */
export class AnchorList {
  constructor({ view, sessions, submaps, frame }) {
    Object.assign(this, { view, sessions, submaps, frame, version: null, found: null });
    byId("anchors").addEventListener("toggle", () => this.toggled());
  }

  /** The version in force, or undefined; it has judged the anchors. */
  show(version) {
    if (version?.name === this.version?.name) return;
    Object.assign(this, { version: version ?? null, found: null });
    byId("anchors").hidden = !version;
    byId("anchors-count").textContent = "";
    this.toggled();
  }

  clear() {
    this.show(undefined);
  }

  /** Another verdict was told. */
  changed() {
    this.found = null;
    this.toggled();
  }

  toggled() {
    if (!this.isOpen) return this.draw();
    if (this.found) return this.render();
    return this.ask(this.version).catch((error) => this.say(inWords(error)));
  }

  get isOpen() {
    return byId("anchors").open && this.version !== null;
  }

  async ask(version) {
    const lists = await Promise.all(this.sessions().map((name) => readAll(`/v1/${name}/anchors`, "anchors")));
    if (version !== this.version) return;
    this.found = lists.flat().sort((a, b) => ORDER.indexOf(stateOf(a)) - ORDER.indexOf(stateOf(b)) || offBy(b) - offBy(a));
    this.render();
  }

  render() {
    const holding = this.found.filter((one) => stateOf(one) === "IN_MAP").length;
    const verb = this.found.some((one) => one.tag) ? "agree" : "hold the map";
    byId("anchors-count").textContent = this.found.length ? `${holding} of ${this.found.length} ${verb}` : "";
    byId("anchor-list").replaceChildren(...this.found.slice(0, SHOWN).map(row));
    this.say(this.summary());
    this.draw();
  }

  summary() {
    if (!this.found.length) return "No anchors: places that the world outside knows put a map on earth.";
    const frames = this.version.summary.georeferences ?? [];
    const earth = frames.map((one) => `${metres(one.residual_m)} off across the ground (root mean square)${frames.length > 1 ? ` in ${one.frame}` : ""}`);
    return [...earth, ...(this.found.length > SHOWN ? [`The first ${SHOWN} of ${plural(this.found.length, "anchor")}`] : [])].join(". ");
  }

  /** Draw them where their submaps are drawn now. */
  draw() {
    const shown = this.isOpen && this.view ? (this.found ?? []).slice(0, MOST_DRAWN) : [];
    const drives = inTime(shown.length ? this.submaps() : []);
    const drawn = shown.map((one) => this.placed(one, drives.get(sessionOf(one.name)) ?? [])).filter(Boolean);
    this.view?.showAnchors(drawn);
    document.body.dataset.drawnAnchors = String(drawn.length);
  }

  /** { state, at, to } of an anchor of a drive: where the map has its point, as drawn, and where its place is; null for none. */
  placed(one, drive) {
    const nearest = nearestInTime(drive, Number(one.stamp_ns));
    const place = nearest && this.view.places.get(nearest.name);
    if (!place) return null;
    const T_drawing_odom = product(place.matrix, inverse(matrixOf(nearest.t_odom_submap)));
    const { x, y, z } = one.offset_m ?? { x: 0, y: 0, z: 0 };
    const at = new Vector3(x, y, z).applyMatrix4(product(T_drawing_odom, matrixOf(one.t_odom_sensor)));
    const earth = (this.version.summary.georeferences ?? []).find(({ frame }) => frame === this.frame());
    if (!one.residual_m || !(earth || one.tag)) return { state: stateOf(one), at, to: at };
    const { x: east, y: north, z: up } = one.residual_m;
    const off = new Vector3(east, north, up);
    if (!one.tag) off.transformDirection(inverse(matrixOf(earth.t_enu_map))).multiplyScalar(offBy(one));
    return { state: stateOf(one), at, to: at.clone().add(off) };
  }

  say(text) {
    byId("anchors-said").hidden = !text;
    byId("anchors-said").textContent = text;
  }
}

const stateOf = (one) => one.state ?? "STATE_UNSPECIFIED";
const offBy = ({ residual_m: off }) => (off ? Math.hypot(off.x, off.y, off.z) : 0);

/** The submaps of each drive by its name, as { submap, at }, in the order of their times, nanoseconds. */
function inTime(submaps) {
  const drives = Map.groupBy(submaps.map((submap) => ({ submap, at: Number(submap.stamp_ns) })), ({ submap }) => sessionOf(submap.name));
  for (const drive of drives.values()) drive.sort((a, b) => a.at - b.at);
  return drives;
}

/** The submap of a drive nearest to a time, of several the first; undefined of none. */
function nearestInTime(drive, at) {
  const after = firstFrom(drive, at);
  const near = [drive[after - 1], drive[after]].filter(Boolean).map((one) => drive[firstFrom(drive, one.at)]);
  return near.sort((a, b) => Math.abs(a.at - at) - Math.abs(b.at - at))[0]?.submap;
}

/** The place of the first of a drive that is not before a time. */
function firstFrom(drive, at) {
  let [low, high] = [0, drive.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (drive[middle].at < at) low = middle + 1;
    else high = middle;
  }
  return low;
}

function row(one) {
  const state = stateOf(one);
  const off = one.residual_m ? `, ${metres(offBy(one))} off` : "";
  const why = one.reason ? anchorReason(one.reason) : "";
  return element(
    "li",
    { "data-state": state, title: why || null },
    element("i", { class: `thing ${state.toLowerCase().replaceAll("_", "-")}` }),
    element("span", {}, `${lastOf(one.name)}${one.tag ? ` (${one.tag})` : ""}: ${state === "IN_MAP" && one.tag ? "agrees" : STATES[state].toLowerCase()}${off}`, element("small", {}, [lastOf(sessionOf(one.name)), why].filter(Boolean).join(" \u00b7 "))),
  );
}
