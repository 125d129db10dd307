// What changed between the drives of the map: asked for when the list is opened, drawn as boxes, between two dates.
"use strict";

import { Refused, readAll } from "/api.js";
import { byId, element, lastOf, plural } from "/dom.js";
import { inWords } from "/tools.js";

const SHOWN = 60;
const AGAIN_MS = 3_000;
const WORDS = { VANISHED: "Vanished", APPEARED: "Appeared", MOVED: "Moved", BACK: "Came back" };

/** `view` is the MapView, `frame()` the frame of the map that is drawn. */
export class DriveChanges {
  constructor({ view, frame }) {
    Object.assign(this, { view, frame, version: null, found: null });
    byId("changes").addEventListener("toggle", () => this.toggled());
    for (const id of ["changes-since", "changes-until"]) byId(id).addEventListener("input", () => this.render());
  }

  /** The version in force, or undefined; changes need two drives in it. */
  show(version) {
    const name = version && version.summary.sessions > 1 ? version.name : null;
    if (name === this.version) return;
    Object.assign(this, { version: name, found: null });
    byId("changes").hidden = !name;
    this.toggled();
  }

  clear() {
    this.show(undefined);
  }

  toggled() {
    const open = byId("changes").open && this.version;
    if (!open) return this.view?.showThings([]);
    if (this.found) return this.render();
    return this.ask(this.version).catch((error) => this.say(inWords(error)));
  }

  /** The changes, asked for again while a worker compares the drives. */
  async ask(version) {
    this.say("The drives are being compared\u2026");
    for (;;) {
      try {
        const found = await readAll(`/v1/${version}/changes`, "map_changes");
        if (version !== this.version) return;
        this.found = found;
        return this.render();
      } catch (error) {
        if (!(error instanceof Refused) || error.reason !== "NO_ANSWER") throw error;
        await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
        if (version !== this.version || !byId("changes").open) return;
      }
    }
  }

  render() {
    if (!this.found) return;
    const [since, until] = [momentOf("changes-since", 0), momentOf("changes-until", 86_400_000)];
    const chosen = this.found.filter((one) => (since === null || ms(one.stamp_ns) >= since) && (until === null || ms(one.stamp_ns) < until));
    this.say(chosen.length ? "" : "Nothing changed that a later drive could see.");
    byId("changes-count").textContent = `${chosen.length}`;
    const latest = [...chosen].sort((a, b) => ms(b.stamp_ns) - ms(a.stamp_ns) || b.points - a.points).slice(0, SHOWN);
    byId("change-list").replaceChildren(...latest.map(row));
    const drawn = chosen.filter((one) => one.frame === this.frame());
    this.view?.showThings(drawn);
    document.body.dataset.drawnThings = String(drawn.length);
    if (chosen.length > SHOWN) this.say(`The latest ${SHOWN} of ${plural(chosen.length, "change")}.`);
  }

  say(text) {
    byId("changes-said").hidden = !text;
    byId("changes-said").textContent = text;
  }
}

const ms = (at_ns) => Number(at_ns) / 1e6;

/** The beginning of the day of an input, so many milliseconds later; null where no day is given. */
function momentOf(id, later_ms) {
  const { value } = byId(id);
  return value ? Date.parse(`${value}T00:00:00Z`) + later_ms : null;
}

function row(one) {
  const size = [one.extent_m.x, one.extent_m.y, one.extent_m.z].map((edge) => edge.toFixed(1)).join(" \u00d7 ");
  const [before, after] = [one.before_ns, one.stamp_ns].map((at) => new Date(ms(at)).toISOString().slice(0, 10));
  return element(
    "li",
    { "data-kind": one.kind, title: `Between ${before} and ${after}` },
    element("i", { class: `thing ${one.kind.toLowerCase()}` }),
    element("span", {}, `${WORDS[one.kind]}, ${size} m`, element("small", {}, `${lastOf(one.session)}, ${after}`)),
  );
}
