// A slice of the map: everything between two heights, and nothing else; two handles, kept apart by a step.
"use strict";

import { byId } from "/dom.js";

const STEP_M = 0.1;
const LEAST_M = 0.2;
const MOVED_M = 0.5;

const metres = (height) => `${height.toFixed(1).replace("-", "\u2212")} m`;

/** `view` is the MapView; `onChanged` hears that the slice is another one. */
export class HeightSlice {
  constructor({ view, onChanged }) {
    Object.assign(this, { view, onChanged, isOn: false, low: -Infinity, high: Infinity, range: [0, 1] });
    byId("slice-on").addEventListener("click", () => this.use(!this.isOn));
    byId("slice-low").addEventListener("input", ({ target }) => this.setLow(Number(target.value)));
    byId("slice-high").addEventListener("input", ({ target }) => this.setHigh(Number(target.value)));
    byId("slice-up").addEventListener("click", () => this.moveBy(MOVED_M));
    byId("slice-down").addEventListener("click", () => this.moveBy(-MOVED_M));
  }

  /** Show a slice, at first of the whole height, or everything. */
  use(isOn) {
    this.isOn = isOn;
    byId("slice").hidden = !isOn;
    byId("slice-on").setAttribute("aria-pressed", String(isOn));
    this.refresh();
    this.apply();
  }

  /** Forget the heights, those of another map. */
  clear() {
    Object.assign(this, { low: -Infinity, high: Infinity });
    if (this.isOn) this.use(false);
  }

  /** What is drawn may reach higher or deeper now; a handle at its end stays there. */
  refresh() {
    const found = this.isOn && this.view?.heights();
    if (!found) return;
    this.range = [Math.floor(found[0] - LEAST_M), Math.ceil(found[1] + LEAST_M)];
    for (const id of ["slice-low", "slice-high"]) Object.assign(byId(id), { min: this.range[0], max: this.range[1], step: STEP_M });
    this.tell();
  }

  /** The heights of both handles, metres: an open end is where the range ends. */
  get ends() {
    const [least, most] = this.range;
    return [Math.max(this.low, least), Math.min(this.high, most)];
  }

  setLow(height) {
    const [least, most] = this.range;
    const low = Math.min(height, most - LEAST_M);
    this.set(downTo(low, least), upTo(Math.max(this.high, low + LEAST_M), most));
  }

  setHigh(height) {
    const [least, most] = this.range;
    const high = Math.max(height, least + LEAST_M);
    const low = Math.min(this.low, high - LEAST_M);
    this.set(downTo(low, least), upTo(high, most));
  }

  /** Move the slice, as thick as it is, as far as there is something. */
  moveBy(by) {
    const [[low, high], [least, most]] = [this.ends, this.range];
    const moved = Math.min(most - high, Math.max(least - low, by));
    if (moved) this.set(low + moved, high + moved);
  }

  set(low, high) {
    Object.assign(this, { low, high });
    this.tell();
    this.apply();
  }

  apply() {
    if (this.isOn) this.view?.cut(this.low, this.high);
    else this.view?.cut(-Infinity, Infinity);
    document.body.dataset.slice = this.inWords();
    this.onChanged();
  }

  tell() {
    const [low, high] = this.ends;
    tellHandle("slice-low", low, Number.isFinite(this.low) ? metres(low) : "lowest");
    tellHandle("slice-high", high, Number.isFinite(this.high) ? metres(high) : "highest");
  }

  /** `from 0.5 m to 2.0 m`; empty where everything is shown. */
  inWords() {
    if (!this.isOn) return "";
    const said = [Number.isFinite(this.low) && `from ${metres(this.low)}`, Number.isFinite(this.high) && `to ${metres(this.high)}`];
    return said.filter(Boolean).join(" ");
  }
}

/** A height, or infinity where the range ends: an open end. */
const upTo = (height, most) => (height >= most ? Infinity : height);
const downTo = (height, least) => (height <= least ? -Infinity : height);

function tellHandle(id, height, words) {
  byId(id).value = String(height);
  byId(id).setAttribute("aria-valuetext", words);
  byId(`${id}-said`).textContent = words;
}
