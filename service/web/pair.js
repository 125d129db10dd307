// A loop closure opened: both submaps side by side and overlaid, before and after, with the evidence in words.
"use strict";

import * as THREE from "/vendor/three-0.187.0/three.module.js";
import { OrbitControls } from "/vendor/three-0.187.0/OrbitControls.js";
import { ByHand } from "/byhand.js";
import { extentOf, geometryOf } from "/clouds.js";
import { MATCH_COLOUR, QUERY_COLOUR, themed } from "/colours.js";
import { byId, element, press, shortName } from "/dom.js";
import { KeypointView } from "/keypoints.js";
import { between, inverse, matrixOf, matrixOfRows, product, turnOf } from "/frames.js";
import { pointsMaterial, surfaceMaterial } from "/scene.js";
import { apart, measures, rivalsOf, sentences, stateOf, verdictOf } from "/words.js";

const SLIDE_MS = 900;
/** The same in page.css: there the overlaid pane lies below the two others, not beside them. */
const NARROW = window.matchMedia("(max-width: 36rem)");

/**
 * The dialog of a loop closure. `onStep` leads to the previous and the next one, `actionsOf` are the buttons it offers,
 * `startOf` tells how two submaps lie if they are moved by hand, and `onRegistered` hears of the loop closure that comes of it.
 */
export class PairView {
  constructor({ onStep, onClose, onRegistered, actionsOf, startOf }) {
    this.dialog = byId("pair");
    this.canvas = byId("pair-view");
    this.keypoints = new KeypointView(byId("pair-keypoints"));
    Object.assign(this, { actionsOf, startOf, onRegistered });
    this.hand = new ByHand({
      canvas: this.canvas,
      camera: () => this.camera,
      onMoved: () => this.draw(),
      onRegistered: (...told) => this.registered(...told),
      onLeft: () => this.leaveHand(),
    });
    this.put_at = new Map();
    this.surface = "points";
    this.share = 1;
    this.opened = 0;
    this.connect(onStep, onClose);
  }

  connect(onStep, onClose) {
    byId("pair-previous").addEventListener("click", () => onStep(-1));
    byId("pair-next").addEventListener("click", () => onStep(1));
    byId("pair-close").addEventListener("click", () => this.dialog.close());
    byId("by-hand").addEventListener("click", () => this.switchHand());
    this.dialog.addEventListener("cancel", (event) => {
      if (!this.hand.isOn || !this.loop.name) return;
      event.preventDefault();
      this.leaveHand();
    });
    this.dialog.addEventListener("close", () => {
      this.useHand(false);
      this.loop = null;
      onClose();
    });
    byId("moment").addEventListener("click", ({ target }) => target.dataset.moment && this.slideTo(target.dataset.moment === "after" ? 1 : 0));
    byId("slide").addEventListener("input", ({ target }) => this.setShare(Number(target.value) / 1000));
    byId("pair-surface").addEventListener("click", ({ target }) => target.dataset.surface && this.showSurface(target.dataset.surface));
    new ResizeObserver(() => this.paint()).observe(this.dialog);
  }

  get isOpen() {
    return this.dialog.open;
  }

  /** Open a loop closure; `T_before` is where odometry puts the query in the match's frame, null where nothing does. */
  open(loop, T_before, position) {
    const another = this.loop?.name !== loop.name || this.hand.isOn;
    this.useHand(false);
    this.loop = loop;
    this.position = position;
    this.T_hand = this.put_at.get(loop.name) ?? null;
    this.T_before = this.T_hand ?? T_before ?? new THREE.Matrix4();
    this.known = Boolean(this.T_hand ?? T_before);
    this.T_after = loop.t_match_query ? matrixOf(loop.t_match_query) : null;
    this.T_shown = this.T_after;
    this.tell(position);
    this.show();
    if (another) this.load();
  }

  show() {
    if (!this.dialog.open) {
      this.dialog.showModal();
      this.canvas.focus({ preventScroll: true });
    }
    this.prepare();
  }

  // -------------------------------------------------------------------------------------------- by hand

  /** Move the query of two submaps by hand which no loop closure joins yet. */
  openByHand(query, match) {
    this.useHand(false);
    this.loop = { name: "", query, match, state: "PROPOSED", reason: "" };
    Object.assign(this, { T_after: null, T_shown: null, T_hand: null, known: false, position: "" });
    this.show();
    this.begin();
  }

  switchHand() {
    if (this.hand.isOn) this.leaveHand();
    else this.begin();
  }

  /** Begin where the query is shown, or else is drawn. */
  async begin() {
    const { query, match } = this.loop;
    const { T_match_query, up } = this.startOf(query, match);
    const shown = this.fromAbove;
    this.hand.begin({ query, match, T_match_query: this.T_shown ?? T_match_query, up });
    this.useHand(true);
    this.tellPair("ambiguous", "Moved by hand", "");
    byId("evidence").replaceChildren(...this.hand.panel());
    byId("evidence").scrollTop = 0;
    this.hand.tell();
    if (shown) this.surface = "points";
    press(byId("pair-surface"), "surface", this.surface);
    await this.load();
    this.canvas.focus({ preventScroll: true });
  }

  /** Back to the loop closure as it is, or to the map where there is none. */
  leaveHand() {
    const { loop, T_before, known, position } = this;
    if (!loop.name) return this.dialog.close();
    this.open(loop, known ? T_before : null, position);
  }

  useHand(isOn) {
    if (!isOn) this.hand.end();
    this.dialog.classList.toggle("moving", isOn);
    byId("by-hand").setAttribute("aria-pressed", String(isOn));
    for (const id of ["pair-previous", "pair-next"]) byId(id).disabled = isOn;
    if (!this.controls) return;
    const [LEFT, RIGHT] = isOn ? [null, THREE.MOUSE.ROTATE] : [THREE.MOUSE.ROTATE, THREE.MOUSE.PAN];
    Object.assign(this.controls.mouseButtons, { LEFT, RIGHT });
    this.controls.touches.ONE = isOn ? null : THREE.TOUCH.ROTATE;
  }

  /** A worker has judged: the loop closure is shown, from where the query was put to where it lies, if nobody left meanwhile. */
  registered(loop, T_hand, isOpen) {
    this.put_at.set(loop.name, T_hand);
    this.onRegistered(loop, isOpen);
  }

  prepare() {
    if (this.renderer) return;
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true });
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#66727e", 1.5));
    const sun = new THREE.DirectionalLight("#ffffff", 1.5);
    sun.position.set(0.9, -1.2, 0.9);
    this.scene.add(sun);
    this.query = new THREE.Group();
    this.match = new THREE.Group();
    this.query.matrixAutoUpdate = false;
    this.scene.add(this.query, this.match);
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.1, 5000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.draw());
  }

  get fromAbove() {
    return this.surface === "keypoints";
  }

  async load() {
    this.dialog.classList.toggle("above", this.fromAbove);
    this.keypoints.canvas.hidden = !this.fromAbove;
    return this.fromAbove ? this.loadKeypoints() : this.loadClouds();
  }

  async loadKeypoints() {
    const opened = (this.opened += 1);
    this.note("Loading the keypoints");
    try {
      const sentence = await this.keypoints.load(this.loop);
      if (opened !== this.opened) return;
      this.setShare(this.share);
      this.paint(); // the sentence stands beside what it tells of
      this.note(sentence);
    } catch (error) {
      if (opened === this.opened) this.note(`The keypoints cannot be shown: ${error.message}`);
    }
  }

  async loadClouds() {
    const opened = (this.opened += 1);
    const { query, match } = this.loop;
    this.query.clear();
    this.match.clear();
    this.note("Loading the submaps");
    this.paint();
    try {
      const [of_query, of_match] = await Promise.all([geometryOf(query, this.surface), geometryOf(match, this.surface)]);
      if (opened !== this.opened) return;
      this.put(this.query, of_query, QUERY_COLOUR);
      this.put(this.match, of_match, MATCH_COLOUR);
      if (!this.hand.isOn) this.look(of_query, of_match);
      else if (this.hand.isNew) this.lookDown(of_query, of_match);
      this.note("");
    } catch (error) {
      if (opened === this.opened) this.note(`The submaps cannot be shown: ${error.message}`);
    }
    if (this.hand.isOn) return this.draw();
    if (this.T_after) {
      this.setShare(0);
      this.slideTo(1);
    } else this.setShare(1);
  }

  put(group, geometry, colour) {
    group.clear();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    group.add(this.surface === "mesh" ? new THREE.Mesh(geometry, surfaceMaterial(colour)) : new THREE.Points(geometry, pointsMaterial(colour, 1.7 * ratio, geometry.userData.heights)));
  }

  /** Look at both in their common frame, from the side of the query's way. */
  look(of_query, of_match) {
    const [centre, radius] = extentOf(of_match);
    const [centre_query, radius_query] = extentOf(of_query);
    if (this.T_after) centre.lerp(centre_query.applyMatrix4(this.T_after), 0.5);
    const reach = Math.max(radius, radius_query);
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).add(new THREE.Vector3(-0.35, -1.0, 1.15).normalize().multiplyScalar(2.1 * reach));
    this.camera.near = reach / 200;
    this.camera.far = reach * 40;
    this.controls.update();
  }

  /** Look from above at both as they lie now, in all their height: so they move as the finger does. */
  lookDown(of_query, of_match) {
    this.hand.between(of_match.userData.heights);
    const [centre, radius] = extentOf(of_match);
    const [centre_query, radius_query] = extentOf(of_query);
    centre_query.applyMatrix4(this.hand.T);
    const reach = Math.max(radius, radius_query) + 0.5 * centre.distanceTo(centre_query);
    this.controls.target.copy(centre.lerp(centre_query, 0.5));
    const back = new THREE.Vector3(0, -0.001, 1).normalize();
    this.camera.position.copy(centre).addScaledVector(back, (2.2 * reach) / Math.min(1, this.canvas.clientWidth / this.canvas.clientHeight));
    this.camera.near = reach / 200;
    this.camera.far = reach * 40;
    this.controls.update();
  }

  async showSurface(surface) {
    if (this.hand.isOn && surface === "keypoints") return;
    this.surface = surface;
    press(byId("pair-surface"), "surface", surface);
    await this.load();
  }

  /** Show another pose of the query: that of a rival, or the loop's own (null). */
  showPose(rows) {
    this.T_shown = rows ? matrixOfRows(rows) : this.T_after;
    this.setShare(1);
  }

  slideTo(share) {
    if (this.hand.isOn) return;
    const [from, began_ms] = [this.share, performance.now()];
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    cancelAnimationFrame(this.sliding);
    const step = (now_ms) => {
      const done = still ? 1 : Math.min(1, (now_ms - began_ms) / SLIDE_MS);
      const eased = done * done * (3 - 2 * done);
      this.setShare(from + (share - from) * eased);
      if (done < 1) this.sliding = requestAnimationFrame(step);
    };
    this.sliding = requestAnimationFrame(step);
  }

  /** 0 is before the loop closure, 1 is after. */
  setShare(share) {
    this.share = share;
    byId("slide").value = String(Math.round(1000 * share));
    press(byId("moment"), "moment", share < 0.5 ? "before" : "after");
    byId("both-name").textContent = this.momentInWords();
    this.draw();
  }

  momentInWords() {
    if (!this.T_after) return "no pose was found";
    if (this.share > 0.98) return this.T_shown === this.T_after ? "with the pose of the loop" : "with a rival pose";
    if (this.share > 0.02) return "";
    if (this.T_hand) return "where it was put by hand";
    return this.known ? "as the odometry has it" : "each at its own origin: no common frame before";
  }

  poseAt(share) {
    return between(this.T_before, this.T_shown ?? this.T_before, share);
  }

  draw() {
    if (this.due) return;
    this.due = requestAnimationFrame(() => this.paint());
  }

  paint() {
    cancelAnimationFrame(this.due);
    this.due = 0;
    if (this.fromAbove) return this.keypoints.paint(this.share);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.renderer || !width || !this.loop) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    this.renderer.setScissorTest(true);
    this.renderer.clippingPlanes = this.hand.planes;
    if (this.hand.isOn) return this.pane([0, 0, width, height], this.hand.T, true, true);
    const [query, match, both] = panes(width, height);
    this.pane(query, this.T_after ?? new THREE.Matrix4(), true, false);
    this.pane(match, null, false, true);
    this.pane(both, this.poseAt(this.share), true, true);
  }

  pane([x, y, width, height], T_match_query, query, match) {
    this.query.visible = query;
    this.match.visible = match;
    if (T_match_query) this.query.matrix.copy(T_match_query);
    this.query.matrixWorldNeedsUpdate = true;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setViewport(x, y, width, height);
    this.renderer.setScissor(x, y, width, height);
    this.renderer.setClearColor(themed("--stage"));
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
  }

  note(text) {
    byId("pair-loading").hidden = !text;
    byId("pair-loading").textContent = text;
  }

  /** Everything about the loop closure that is not drawn. */
  tell(position) {
    const { loop } = this;
    this.tellPair(stateOf(loop), verdictOf(loop), position);
    byId("evidence").replaceChildren(...this.evidence(loop));
  }

  tellPair(state, words, position) {
    const { query, match } = this.loop;
    const verdict = byId("pair-verdict");
    verdict.className = `verdict ${state}`;
    verdict.replaceChildren(element("i", { class: `sign ${state}` }), words, element("span", { class: "soft" }, position));
    byId("pair-title").replaceChildren(element("span", { class: "end" }, shortName(query)), " ", element("span", { class: "end" }, `\u2192 ${shortName(match)}`));
    byId("query-name").textContent = shortName(query);
    byId("match-name").textContent = shortName(match);
  }

  /** Where the query lies in the frame of the match, and how far from where it was put by hand. */
  poseInWords(loop) {
    if (!this.T_after || !loop.evidence?.measurement) return this.T_hand ? "No pose was found from where it was put by hand." : null;
    const [x, y, z] = this.T_after.elements.slice(12, 15).map((along) => along.toFixed(2).replace("-", "\u2212"));
    const turn = (turnOf(this.T_after, this.startOf(loop.query, loop.match).up) * 180) / Math.PI;
    const told = `Pose of the query in the frame of the match: x ${x} m, y ${y} m, z ${z} m, turned by ${turn.toFixed(1).replace("-", "\u2212")}\u00b0`;
    return this.T_hand ? `${told}; ${apart(product(this.T_after, inverse(this.T_hand)))} from where it was put by hand.` : `${told}.`;
  }

  evidence(loop) {
    const rivals = rivalsOf(loop);
    const lies = this.poseInWords(loop);
    const off = this.known && !this.T_hand && this.T_after ? apart(product(this.T_after, inverse(this.T_before))) : null;
    return [
      element("h3", {}, "Why"),
      ...sentences(loop).map((sentence) => element("p", {}, sentence)),
      off && loop.state === "ACCEPTED" ? element("p", {}, `Odometry had put the query ${off} from here.`) : null,
      lies && element("p", {}, lies),
      element("h3", {}, "Measured"),
      ...measures(loop).map(bar),
      rivals.length ? element("h3", {}, "Poses that fit") : null,
      rivals.length ? this.rivalList(rivals) : null,
      ...this.actionsOf(loop),
      element("p", { class: "fine" }, `${loop.name.split("/").at(-1)}, found ${new Date(Number(loop.created_at_ns) / 1e6).toLocaleString()}`),
    ].filter(Boolean);
  }

  rivalList(rivals) {
    const list = element("ol", { class: "rivals" });
    const choose = (button, rows) => () => {
      for (const other of list.querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === button));
      this.showPose(rows);
    };
    const entry = (text, rows, pressed) => {
      const button = element("button", { type: "button", "aria-pressed": String(pressed) }, text);
      button.addEventListener("click", choose(button, rows));
      list.append(element("li", {}, button));
    };
    const best = this.loop.evidence.measurement.overlap;
    entry(`Best: overlap ${Math.round(100 * best)} %`, null, true);
    for (const { overlap, rows } of rivals) {
      const where = this.T_after ? `, ${apart(product(matrixOfRows(rows), inverse(this.T_after)))}` : "";
      entry(`Overlap ${Math.round(100 * overlap)} %${where}`, rows, false);
    }
    return list;
  }
}

/** Where the query, the match and both overlaid are drawn: [x, y, width, height] each, from the lower left. */
function panes(width, height) {
  if (NARROW.matches) {
    const [half, below] = [Math.round(width / 2), Math.round(0.64 * height)];
    const above = height - below - 1;
    return [[0, below + 1, half - 1, above], [half, below + 1, width - half, above], [0, 0, width, below]];
  }
  const [left, half] = [Math.round(0.36 * width), Math.round(height / 2)];
  return [[0, half, left - 1, height - half], [0, 0, left - 1, half - 1], [left, 0, width - left, height]];
}

function bar([name, value, threshold, more, help]) {
  const met = threshold === null || (more ? value >= threshold : value <= threshold);
  const rule = threshold === null ? null : element("span", { class: "threshold", share: Math.max(0, Math.min(1, threshold)), title: `${more ? "At least" : "At most"} ${threshold.toFixed(2)}` });
  return element(
    "div",
    { class: `measure${met ? "" : " missed"}`, title: help },
    element("span", { class: "name" }, name),
    element("span", { class: "value" }, value.toFixed(2)),
    element("span", { class: "track" }, element("span", { class: "fill", share: Math.max(0, Math.min(1, value)) }), rule),
  );
}
