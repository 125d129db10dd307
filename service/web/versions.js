// The versions of the map: what changed from one to the next, drawn on demand, and the way back.
"use strict";

import { read, readAll, send } from "/api.js";
import { byId, element, plural, refill } from "/dom.js";
import { matrixOf } from "/frames.js";
import { inWords } from "/tools.js";

const SHOWN = 6;

/** `view` is the MapView, `onChanged` hears that the map is another one. */
export class Versions {
  constructor({ view, onChanged }) {
    Object.assign(this, { view, onChanged, map: null, versions: [], compared: null });
  }

  async show(map) {
    this.map = map;
    const answer = await read(`/v1/${map}/versions?page_size=100`).catch(() => ({ map_versions: [] }));
    if (map !== this.map) return;
    this.versions = (answer.map_versions ?? answer.versions ?? []).sort((a, b) => Number(b.version) - Number(a.version));
    this.render();
  }

  /** The version in force, or undefined. */
  get inForce() {
    return this.versions.find((version) => version.in_force);
  }

  clear() {
    Object.assign(this, { map: null, versions: [], compared: null });
    this.render();
  }

  render() {
    byId("versions").hidden = !this.versions.length;
    byId("versions-count").textContent = this.versions.length ? `${this.versions.length}` : "";
    refill(byId("version-list"), ...this.versions.slice(0, SHOWN).map((version, index) => this.row(version, index)));
  }

  row(version, index) {
    const { summary } = version;
    const changed = summary.max_change_m === undefined || summary.max_change_m === null ? "" : ` \u00b7 moved by ${summary.max_change_m.toFixed(2)} m`;
    const detail = `${plural(summary.loops_in_map, "loop")}${changed}${Number(version.restored_from) ? ` \u00b7 as version ${version.restored_from}` : ""}`;
    const pressed = this.compared === version.version;
    const before = this.versions[index + 1];
    return element(
      "li",
      { "data-version": version.version, "data-name": version.name },
      element("span", { title: new Date(Number(version.created_at_ns) / 1e6).toLocaleString() }, `Version ${version.version}${version.in_force ? ", in force" : ""}`, element("small", {}, detail)),
      before && element("button", { type: "button", class: "link", "aria-pressed": String(pressed), title: `What changed since version ${before.version}`, onclick: () => this.compare(version, before) }, pressed ? "hide" : "changes"),
      !version.in_force && element("button", { type: "button", class: "link", title: "Bring the poses of this version back, as a new version", onclick: () => this.goBack(version) }, "go back"),
    );
  }

  /** Draw how far each submap moved between two versions; once more hides it. */
  async compare(version, before) {
    if (this.compared === version.version) {
      this.compared = null;
      this.view?.showChanges([]);
      this.say("");
      return this.render();
    }
    const [now, then] = await Promise.all([version, before].map(posesOf)).catch((error) => [null, error]);
    if (!now) return this.say(inWords(then));
    const moves = [...now].filter(([name]) => then.has(name)).map(([name, at]) => ({ name, from: then.get(name), to: at }));
    const lengths = moves.map(({ from, to }) => from.distanceTo(to)).sort((a, b) => a - b);
    const more = [...now.keys()].filter((name) => !then.has(name)).length;
    this.compared = version.version;
    this.view?.showChanges(moves);
    document.body.dataset.drawnChanges = String(moves.length);
    const middle = lengths[lengths.length >> 1] ?? 0;
    this.say(`Version ${before.version} to ${version.version}: ${plural(moves.length, "submap")} moved by ${middle.toFixed(2)} m at the median, ${(lengths.at(-1) ?? 0).toFixed(2)} m at most${more ? `; ${plural(more, "submap")} more` : ""}.`);
    this.render();
  }

  async goBack(version) {
    if (!window.confirm(`Bring the poses of version ${version.version} back? They become a new version of the map.`)) return;
    try {
      await send(`/v1/${this.map}:revert`, { version: Number(version.version) });
      this.onChanged();
    } catch (error) {
      this.say(inWords(error));
    }
  }

  say(text) {
    byId("version-said").hidden = !text;
    byId("version-said").textContent = text;
  }
}

/** Where a version has each submap: positions by name. */
async function posesOf(version) {
  const poses = await readAll(`/v1/${version.name}/poses`, "submap_poses");
  return new Map(poses.map((pose) => [pose.submap, positionOf(pose)]));
}

function positionOf(pose) {
  const { elements: e } = matrixOf(pose.t_map_submap);
  return { x: e[12], y: e[13], z: e[14], distanceTo: (other) => Math.hypot(e[12] - other.x, e[13] - other.y, e[14] - other.z) };
}

