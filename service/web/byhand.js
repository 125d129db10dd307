// One cloud of a pair moved by hand over the other: its pose in numbers, and the way to let the service register from there.
"use strict";

import { Matrix4, Plane, Raycaster, Vector2, Vector3 } from "/vendor/three-0.187.0/three.module.js";
import { read, send } from "/api.js";
import { byId, element } from "/dom.js";
import { poseText, turnOf } from "/frames.js";
import { inWords } from "/tools.js";

const ASKED_EVERY_MS = 500;
const DEGREE = Math.PI / 180;
const FINE = { metres: 0.1, degrees: 1 };
const COARSE = { metres: 1, degrees: 10 };
const MOST_M = 10_000;
const ROWS = [
  { id: "x", label: "Along x", unit: "m" },
  { id: "y", label: "Along y", unit: "m" },
  { id: "z", label: "Height", unit: "m" },
  { id: "turn", label: "Turned", unit: "\u00b0" },
];

/**
 * The pose T_match_query of a pair while a person moves the query. `canvas` shows both through `camera()`; `onMoved` hears of
 * each move, `onRegistered` of the loop closure with its verdict and of where the query was put, `onLeft` of the end.
 */
export class ByHand {
  constructor({ canvas, camera, onMoved, onRegistered, onLeft }) {
    Object.assign(this, { canvas, camera, onMoved, onRegistered, onLeft, pair: null, steps: FINE, held: null, planes: [] });
    canvas.addEventListener("pointerdown", (event) => this.take(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const ends of ["pointerup", "pointercancel"]) canvas.addEventListener(ends, () => (this.held = null));
    canvas.addEventListener("keydown", (event) => this.press(event));
  }

  get isOn() {
    return this.pair !== null;
  }

  /** Begin with a pose of the query in the match's frame; `up` is the vertical there. */
  begin({ query, match, T_match_query, up }) {
    Object.assign(this, { pair: { query, match }, start: T_match_query.clone(), T: T_match_query.clone(), up, steps: FINE, isNew: true });
  }

  end() {
    Object.assign(this, { pair: null, held: null, planes: [] });
  }

  // -------------------------------------------------------------------------------------------- moving

  set(T) {
    this.T = T;
    this.tell();
    this.onMoved();
  }

  /** Move by a vector of the match's frame, metres. */
  moveBy(by) {
    this.set(new Matrix4().makeTranslation(by.x, by.y, by.z).multiply(this.T));
  }

  /** Turn the query about the vertical through its own origin, radians. */
  turnBy(angle) {
    const at = new Vector3().setFromMatrixPosition(this.T);
    this.set(new Matrix4().makeRotationAxis(this.up, angle).multiply(this.T).setPosition(at));
  }

  /** Give one of the numbers that tell the pose. */
  setNumber(id, value) {
    if (!Number.isFinite(value)) return this.tell();
    if (id === "turn") return this.turnBy((value - this.numbers().turn) * DEGREE);
    const at = new Vector3().setFromMatrixPosition(this.T);
    at[id] = Math.max(-MOST_M, Math.min(MOST_M, value));
    return this.set(this.T.clone().setPosition(at));
  }

  /** x, y and z in the frame of the match, metres, and the turn about the vertical, degrees. */
  numbers() {
    const { x, y, z } = new Vector3().setFromMatrixPosition(this.T);
    return { x, y, z, turn: turnOf(this.T, this.up) / DEGREE };
  }

  /** Where a ray through a point of the canvas meets the level plane through the query's origin. */
  under({ offsetX, offsetY }) {
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * offsetX) / this.canvas.clientWidth - 1, 1 - (2 * offsetY) / this.canvas.clientHeight), this.camera());
    return caster.ray.intersectPlane(new Plane().setFromNormalAndCoplanarPoint(this.up, new Vector3().setFromMatrixPosition(this.T)), new Vector3());
  }

  take(event) {
    this.held = this.isOn && event.isPrimary && event.button === 0 ? this.under(event) : null;
  }

  drag(event) {
    if (!this.held) return;
    const at = event.isPrimary ? this.under(event) : null;
    if (!at) return (this.held = null); // a second finger moves the view, and above the horizon there is no plane
    this.moveBy(at.clone().sub(this.held));
    this.held = at;
  }

  /** Arrows move along the plane as it is seen, PageUp and PageDown raise and lower, comma and full stop turn. */
  press(event) {
    if (!this.isOn || event.ctrlKey || event.metaKey || event.altKey) return;
    const { right, ahead } = this.axes();
    const step = (event.shiftKey ? COARSE : this.steps).metres;
    const moves = { ArrowRight: [right, 1], ArrowLeft: [right, -1], ArrowUp: [ahead, 1], ArrowDown: [ahead, -1], PageUp: [this.up, 1], PageDown: [this.up, -1] };
    const [way, sign] = moves[event.key] ?? [];
    const turn = { ",": 1, ".": -1 }[event.key];
    if (way) this.moveBy(way.clone().multiplyScalar(sign * step));
    else if (turn) this.turnBy(turn * this.steps.degrees * DEGREE);
    else return;
    event.preventDefault();
  }

  /** To the right and away, as the plane is seen: unit vectors. */
  axes() {
    const right = new Vector3().setFromMatrixColumn(this.camera().matrixWorld, 0);
    right.addScaledVector(this.up, -right.dot(this.up)).normalize();
    return { right, ahead: new Vector3().crossVectors(this.up, right) };
  }

  // -------------------------------------------------------------------------------------------- the panel

  /** What stands beside the clouds while they are moved. */
  panel() {
    this.said = element("p", { role: "status", class: "wide" });
    this.note = element("input", { type: "text", placeholder: "Why? (noted with the loop closure)", maxlength: 256, "aria-label": "Why" });
    this.go = element("button", { type: "button", id: "hand-go", onclick: () => this.register() }, "Register from here");
    const back = element("button", { type: "button", class: "plain", onclick: () => this.set(this.start.clone()) }, "Start again");
    const leave = element("button", { type: "button", class: "plain", onclick: () => this.onLeft() }, "Leave");
    return [
      element("h3", {}, "Move by hand"),
      element("p", {}, "Drag the orange cloud over the blue one, and turn it until both fit. A few degrees matter more than a metre."),
      element("div", { class: "slides" }, ...this.slide("hand-slide", "Turn", "Turned, degrees", (value) => this.setNumber("turn", value)), ...this.slide("hand-most", "Up to", "Greatest height that is shown, metres", (value) => this.cut(value))),
      element("div", { class: "actions" }, this.note, this.said, this.go, back, leave),
      element("div", { class: "pose" }, ...ROWS.flatMap((row) => this.row(row))),
      this.stepChoice(),
      element("p", { class: "fine" }, "Keys, with the drawing chosen: arrows move, Page Up and Page Down raise and lower, comma and full stop turn, with Shift ten times as far. Two fingers, or the right button, move the view."),
    ];
  }

  row({ id, label, unit }) {
    const number = element("input", { type: "number", id: `hand-${id}`, step: "any", inputmode: "decimal", "aria-label": `${label}, ${unit === "m" ? "metres" : "degrees"}` });
    number.addEventListener("change", () => this.setNumber(id, Number(number.value)));
    const step = (sign) => () => this.setNumber(id, this.numbers()[id] + sign * (unit === "m" ? this.steps.metres : this.steps.degrees));
    const button = (sign, text, word) => element("button", { type: "button", "aria-label": `${label}: ${word}`, onclick: step(sign) }, text);
    return [element("label", { for: `hand-${id}` }, label), button(-1, "\u2212", "less"), number, element("span", {}, unit), button(1, "+", "more")];
  }

  slide(id, label, meaning, work) {
    const slide = element("input", { type: "range", id, min: -180, max: 180, step: 1, "aria-label": meaning });
    slide.addEventListener("input", () => work(Number(slide.value)));
    return [element("label", { for: id }, label), slide];
  }

  /** The heights between which the match lies, metres above its origin: a ceiling can be taken off. */
  between([low, high]) {
    this.isNew = false;
    Object.assign(byId("hand-most"), { min: Math.floor(low), max: Math.ceil(high) + 1, step: 0.1 });
    byId("hand-most").value = byId("hand-most").max;
    this.cut(Infinity);
  }

  cut(height) {
    const isAll = height >= Number(byId("hand-most").max);
    this.planes = isAll ? [] : [new Plane(this.up.clone().negate(), height)];
    byId("hand-most").setAttribute("aria-valuetext", isAll ? "highest" : `${height.toFixed(1)} m`);
    this.onMoved();
  }

  stepChoice() {
    const choices = [[FINE, "0.1 m, 1\u00b0"], [COARSE, "1 m, 10\u00b0"]].map(([steps, text]) => {
      const button = element("button", { type: "button", "aria-pressed": String(steps === this.steps) }, text);
      button.addEventListener("click", () => {
        this.steps = steps;
        for (const [other, its] of choices) other.setAttribute("aria-pressed", String(its === steps));
      });
      return [button, steps];
    });
    return element("div", { class: "group", role: "group", "aria-label": "How far a step goes" }, ...choices.map(([button]) => button));
  }

  tell() {
    const numbers = this.numbers();
    for (const { id, unit } of ROWS) if (byId(`hand-${id}`)) byId(`hand-${id}`).value = numbers[id].toFixed(unit === "m" ? 2 : 1);
    if (byId("hand-slide")) byId("hand-slide").value = numbers.turn.toFixed(0);
  }

  // -------------------------------------------------------------------------------------------- registering

  /** Let a worker register the pair from here; it judges as it judges every loop closure. */
  async register() {
    const { pair, T, go } = this;
    go.disabled = true;
    this.say("A worker registers the two\u2026");
    try {
      const map = pair.query.split("/").slice(0, 2).join("/");
      const { loop_closure, operation } = await send(`/v1/${map}/loopClosures`, { ...pair, note: this.note.value, T_match_query: poseText(T) });
      await ended(operation);
      const loop = await read(`/v1/${loop_closure.name}`);
      this.onRegistered(loop, T, pair === this.pair);
    } catch (error) {
      if (pair === this.pair) this.say(inWords(error), true);
      go.disabled = false;
    }
  }

  say(text, bad = false) {
    this.said.textContent = text;
    this.said.classList.toggle("bad", bad);
  }
}

/** Wait until an operation has ended. Raises where it failed. */
async function ended(operation) {
  for (let told = operation; ; told = await read(`/v1/${operation.name}`)) {
    if (told.state === "DONE") return;
    if (told.state === "FAILED") throw new Error(told.failure?.message ?? "the registration failed");
    await new Promise((resolve) => setTimeout(resolve, ASKED_EVERY_MS));
  }
}
