// What a click on the map does beside choosing: measure between two points, and join two submaps by hand.
"use strict";

import { KeyNeeded, Refused, send } from "/api.js";
import { byId, element, press, shortName } from "/dom.js";
import { poseText } from "/frames.js";

const SAID = { measure: "Click two points", join: "Click two submaps that show the same place" };

const metres = (length) => (length < 10 ? `${length.toFixed(2)} m` : `${length.toFixed(1)} m`);

/**
 * One tool at a time. `view` is the MapView, `mapName()` the map that is shown, `notDrawn()` its submaps that are not drawn;
 * `onJoined` hears of the loop closure, `onMove` of two submaps one of which is to be moved by hand.
 */
export class Tools {
  constructor({ view, mapName, notDrawn, onJoined, onMove }) {
    Object.assign(this, { view, mapName, notDrawn, onJoined, onMove, tool: "none", points: [], ends: [], guest: null });
    byId("tools").addEventListener("click", ({ target }) => target.dataset.tool && this.use(this.tool === target.dataset.tool ? "none" : target.dataset.tool));
  }

  get isOn() {
    return this.tool !== "none";
  }

  /** `guest` is another part of the page that wants the clicks: it has take(x, y), and leave() for when it has them no more. */
  use(tool, guest = null) {
    const before = this.guest;
    Object.assign(this, { tool, guest, points: [], ends: [] });
    before?.leave();
    press(byId("tools"), "tool", tool);
    document.body.dataset.tool = tool;
    this.view?.measure([]);
    this.view?.mark([]);
    this.say(SAID[tool], tool === "join" && this.others());
  }

  /** A click at a point of the canvas, in CSS pixels. */
  take(x, y) {
    if (this.guest) this.guest.take(x, y);
    else if (this.tool === "measure") this.takePoint(this.view.pick(x, y));
    else if (this.tool === "join") this.takeSubmap(this.view.nearest(x, y)?.submap);
  }

  takePoint(at) {
    if (!at) return;
    this.points = this.points.length === 2 ? [at] : [...this.points, at];
    this.view.measure(this.points);
    if (this.points.length < 2) return this.say("Click the second point");
    const [a, b] = this.points;
    const level = Math.hypot(b.x - a.x, b.y - a.y);
    document.body.dataset.measured = a.distanceTo(b).toFixed(3);
    this.say(`${metres(a.distanceTo(b))}: ${metres(level)} level, ${metres(Math.abs(b.z - a.z))} ${b.z < a.z ? "down" : "up"}`);
  }

  takeSubmap(submap) {
    if (!submap || this.ends.some(({ name }) => name === submap.name)) return;
    this.ends = this.ends.length === 2 ? [submap] : [...this.ends, submap];
    this.view.mark(this.ends.map(({ name }) => name), this.ends.length === 2 ? {} : null);
    if (this.ends.length < 2) return this.say(`${shortName(submap.name)}, and the second submap?`, this.others());
    this.ask(...this.ends);
  }

  /** A list of the submaps that cannot be clicked, or null where all are drawn. */
  others() {
    const found = this.notDrawn().filter(({ name }) => !this.ends.some((end) => end.name === name));
    if (!found.length) return null;
    const options = found.map(({ name }) => element("option", { value: name }, shortName(name)));
    const list = element("select", { "aria-label": "A submap that is not drawn" }, element("option", { value: "" }, "or one that is not drawn"), ...options);
    list.addEventListener("change", () => this.takeSubmap(found.find(({ name }) => name === list.value)));
    return list;
  }

  /** The two submaps, and what to do with them. */
  ask(query, match) {
    const note = element("input", { type: "text", placeholder: "Why? (noted with your decision)", maxlength: 256, "aria-label": "Why" });
    const drawn = this.view.relative(match.name, query.name);
    const near = element("input", { type: "checkbox", id: "as-drawn" });
    const said = element("p", { role: "alert" });
    const join = element("button", { type: "button" }, "Join them");
    join.addEventListener("click", async () => {
      join.disabled = true;
      said.textContent = "";
      try {
        const guess = near.checked ? { T_match_query: poseText(drawn) } : {};
        const answer = await send(`/v1/${this.mapName()}/loopClosures`, { query: query.name, match: match.name, note: note.value, ...guess });
        this.use("none");
        this.onJoined(answer.loop_closure);
      } catch (error) {
        said.textContent = inWords(error);
        join.disabled = false;
      }
    });
    const move = element("button", { type: "button", class: "plain", onclick: () => this.move(query, match) }, "Move by hand");
    this.say(
      element("strong", {}, `${shortName(query.name)} \u2192 ${shortName(match.name)}`),
      drawn && element("label", { for: "as-drawn" }, near, " begin where they are drawn"),
      element("div", { class: "actions" }, note, join, move, element("button", { type: "button", class: "plain", onclick: () => this.use("none") }, "Leave it"), said),
    );
  }

  move(query, match) {
    this.use("none");
    this.onMove(query.name, match.name);
  }

  say(...what) {
    const told = what.filter(Boolean);
    byId("told").hidden = !told.length;
    byId("told").replaceChildren(...told);
  }
}

export function inWords(error) {
  if (error instanceof KeyNeeded) return "An API key is needed";
  if (error instanceof Refused && error.status === 403) return "This key may look, but not change the map: that needs the scope admin.";
  return error.message;
}
