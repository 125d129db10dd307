// Plans of the map: pictures that lie underneath it, each held by two pins. The browser alone decodes a picture.
"use strict";

import { readAll, readFile, remove, send, sendFile } from "/api.js";
import { byId, element, lastOf, refill } from "/dom.js";
import { PicturePins } from "/picture.js";
import { plainPicture } from "/plainpicture.js";
import { inWords } from "/tools.js";

const MOST_SIDE = 4096;
const OPACITY = 0.7;
const KEPT = "revisit-plan:";

/** How a picture with two pins lies on the ground: { at(pixel x, pixel y) }, metres; scaled, turned and moved. */
export function planeOf([one, other]) {
  const [u, v] = [other.pixel_x - one.pixel_x, one.pixel_y - other.pixel_y];
  const [x, y] = [other.x_m - one.x_m, other.y_m - one.y_m];
  const square = u * u + v * v;
  const [re, im] = [(x * u + y * v) / square, (y * u - x * v) / square];
  return {
    metres_per_pixel: Math.hypot(re, im),
    at: (pixel_x, pixel_y) => {
      const [right, up] = [pixel_x - one.pixel_x, one.pixel_y - pixel_y];
      return [one.x_m + re * right - im * up, one.y_m + re * up + im * right];
    },
  };
}

/** A picture as it is drawn, its size as its bytes have it, and the file; the turn that EXIF asks for is not made. */
async function decoded(bytes) {
  const file = plainPicture(new Uint8Array(bytes));
  const whole = await createImageBitmap(file);
  const { width, height } = whole;
  const share = Math.min(1, MOST_SIDE / Math.max(width, height));
  if (share === 1) return { image: whole, width, height, file };
  const resize = { resizeWidth: Math.max(1, Math.round(share * width)), resizeHeight: Math.max(1, Math.round(share * height)), resizeQuality: "medium" };
  const image = await createImageBitmap(whole, resize);
  whole.close();
  return { image, width, height, file };
}

/**
 * `view` is the MapView, `tools` gives a click on the map to who asks for it, `frame()` is that of the map which is drawn,
 * `heightOf(storey)` how high its floor is drawn, and `lookDown()` shows the map from above, with its points.
 */
export class Plans {
  constructor({ view, tools, frame, heightOf, lookDown }) {
    Object.assign(this, { view, tools, frame, heightOf, lookDown, map: null, plans: [], pictures: new Map(), draft: null });
    this.pins = new PicturePins();
    byId("plan-file").addEventListener("change", ({ target }) => {
      const [file] = target.files;
      target.value = "";
      if (file) this.add(file);
    });
    // Plans make no events: what others put there is read when somebody looks.
    byId("plans").addEventListener("toggle", ({ target }) => target.open && this.map && this.show(this.map));
  }

  /** The plans of a map, or of none. */
  async show(map) {
    if (map !== this.map) this.forget();
    this.map = map;
    byId("plans").hidden = !map;
    const plans = map ? await readAll(`/v1/${map}/plans`, "plans").catch(() => []) : [];
    if (map !== this.map) return;
    this.plans = plans;
    // A plan that was deleted and made anew under its id has another picture.
    for (const [name, { made }] of this.pictures) if (!plans.some((plan) => plan.name === name && makeOf(plan) === made)) this.drop(name);
    this.render();
  }

  forget() {
    this.leave();
    for (const name of this.pictures.keys()) this.drop(name);
    this.plans = [];
    this.say("");
  }

  clear() {
    this.show(null);
  }

  // -------------------------------------------------------------------------------------------- the list

  render() {
    byId("plans-count").textContent = this.plans.length || "";
    refill(byId("plan-list"), ...this.plans.map((plan) => this.row(plan)));
    this.draw();
  }

  row(plan) {
    const mine = this.choiceOf(plan);
    const box = element("input", { type: "checkbox", "aria-label": `Show ${titleOf(plan)}` });
    box.checked = mine.shown;
    box.addEventListener("change", () => this.choose(plan, { shown: box.checked }));
    const slide = element("input", { type: "range", min: 0.05, max: 1, step: 0.05, "aria-label": `Opacity of ${titleOf(plan)}` });
    slide.value = mine.opacity;
    slide.addEventListener("input", () => this.choose(plan, { opacity: Number(slide.value), shown: true }, box));
    const detail = [plan.storey && `storey ${plan.storey}`, this.isHere(plan) ? `${scaleOf(plan)} a pixel` : "in another part of the map"];
    return element(
      "li",
      { "data-plan": plan.name, "data-name": plan.name },
      element("label", {}, box, element("span", {}, titleOf(plan), element("small", {}, detail.filter(Boolean).join(" \u00b7 ")))),
      slide,
      element("button", { type: "button", class: "link", title: "Set its two points anew", onclick: () => this.pinAnew(plan) }, "points"),
      element("button", { type: "button", class: "link", title: "Delete it for everybody", onclick: () => this.delete(plan) }, "delete"),
    );
  }

  /** What this viewer has chosen, kept by the browser: { shown, opacity }. The first plan is shown at first. */
  choiceOf(plan) {
    const kept = JSON.parse(localStorage.getItem(KEPT + plan.name) ?? "{}");
    return { shown: plan === this.plans[0], opacity: OPACITY, ...kept };
  }

  choose(plan, choice, box = null) {
    localStorage.setItem(KEPT + plan.name, JSON.stringify({ ...this.choiceOf(plan), ...choice }));
    if (box) box.checked = true;
    this.draw();
  }

  async delete(plan) {
    if (!window.confirm(`Delete the plan ${titleOf(plan)} for everybody?`)) return;
    try {
      await remove(`/v1/${plan.name}`);
      localStorage.removeItem(KEPT + plan.name);
      this.drop(plan.name);
      await this.show(this.map);
    } catch (error) {
      this.say(inWords(error));
    }
  }

  // ---------------------------------------------------------------------------------------------- drawing

  isHere(plan) {
    return !plan.frame || this.frame() === null || plan.frame === this.frame();
  }

  /** Draw those that are shown, as the map lies now, and the one that is being pinned. */
  draw() {
    if (!this.view) return;
    const shown = this.plans.filter((plan) => plan.name !== this.draft?.name && this.choiceOf(plan).shown && this.isHere(plan));
    const drawn = shown.filter((plan) => this.pictureOf(plan)).map((plan) => this.drawing(plan, this.pictureOf(plan), this.choiceOf(plan).opacity));
    const { draft } = this;
    if (draft?.ground.length === 2) drawn.push(this.drawing({ ...draft, pins: this.draftPins() }, draft.picture, OPACITY));
    this.view.showPlans(drawn);
    document.body.dataset.drawnPlans = String(drawn.length);
  }

  drawing({ name, pins, storey }, { image, width, height }, opacity) {
    const { at } = planeOf(pins);
    const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([x, y]) => at(x, y));
    return { name, image, opacity, corners, height: this.heightOf(storey) };
  }

  /** The decoded picture of a plan; null until it has come, which draws it. */
  pictureOf(plan) {
    if (!this.pictures.has(plan.name)) {
      this.keep(plan, null);
      this.read(plan).then(() => this.draw(), (error) => this.say(`${titleOf(plan)}: ${inWords(error)}`));
    }
    return this.pictures.get(plan.name).picture;
  }

  async read(plan) {
    const known = this.pictures.get(plan.name)?.picture;
    if (known) return known;
    const map = this.map;
    const picture = await decoded(await readFile(`/v1/${plan.name}:download`));
    if (map === this.map) this.keep(plan, picture);
    return picture;
  }

  keep(plan, picture) {
    this.pictures.set(plan.name, { picture, made: makeOf(plan) });
  }

  drop(name) {
    this.pictures.get(name)?.picture?.image.close();
    this.pictures.delete(name);
  }

  // ---------------------------------------------------------------------------------------------- two points

  async add(file) {
    this.say("");
    if (!this.view) return this.say("This browser offers no WebGL: the map cannot be clicked.");
    const picture = await file.arrayBuffer().then(decoded).catch(() => null);
    if (!picture) return this.say(`${file.name} cannot be shown: a plan is a PNG or a JPEG picture.`);
    this.begin({ name: "", title: file.name.replace(/\.[^.]*$/, ""), storey: "", isNew: true, picture });
  }

  async pinAnew(plan) {
    this.say("");
    const picture = await this.read(plan).catch((error) => this.say(`${titleOf(plan)}: ${inWords(error)}`));
    if (picture) this.begin({ name: plan.name, title: titleOf(plan), storey: plan.storey, isNew: false, picture }, plan.pins);
  }

  /** First two points of the picture, then the same two of the map. */
  async begin(draft, before = []) {
    const pixels = await this.pins.ask(draft.title, draft.picture, before.map(({ pixel_x, pixel_y }) => [pixel_x, pixel_y]));
    if (!pixels) return;
    this.tools.use("plan", this);
    this.draft = { ...draft, pixels, ground: [] };
    this.ask();
    // Now that what is said covers its part of the stage.
    this.lookDown();
  }

  /** A click at a point of the canvas: the next point, or the nearer one anew. */
  take(x, y) {
    const { draft } = this;
    const at = this.view.pickGround(x, y, this.heightOf(draft.storey));
    if (!at) return;
    if (draft.ground.length < 2) draft.ground.push(at);
    else {
      const [one, other] = draft.ground.map((point) => point.distanceTo(at));
      draft.ground[one <= other ? 0 : 1] = at;
    }
    this.view.measure(draft.ground, false);
    this.ask();
    this.draw();
  }

  draftPins() {
    const { pixels, ground } = this.draft;
    return pixels.map(([pixel_x, pixel_y], index) => ({ pixel_x, pixel_y, x_m: ground[index].x, y_m: ground[index].y }));
  }

  ask() {
    const { draft } = this;
    const left = 2 - draft.ground.length;
    if (left) {
      const leave = element("button", { type: "button", class: "plain", onclick: () => this.tools.use("none") }, "Cancel");
      const number = draft.ground.length + 1;
      const thumb = element("div", { class: "thumb" }, this.pins.thumbnail(draft.picture, draft.pixels[number - 1]));
      return this.tools.say(element("div", { class: "beside" }, thumb, element("div", {}, element("strong", {}, `Click point ${number} of the picture in the map`), element("div", { class: "actions" }, leave))));
    }
    if (byId("plan-save")) return undefined;
    return this.tools.say(...this.lastStep());
  }

  /** Under which name it is kept, once both points are there. */
  lastStep() {
    const { draft } = this;
    const name = element("input", { type: "text", maxlength: 256, value: draft.title, "aria-label": "Name of the plan" });
    const storey = element("input", { type: "text", maxlength: 64, value: draft.storey, placeholder: "Storey (optional)", "aria-label": "Storey" });
    const said = element("p", { role: "alert" });
    const save = element("button", { type: "button", id: "plan-save" }, "Save");
    save.addEventListener("click", async () => {
      save.disabled = true;
      said.textContent = "";
      try {
        await this.save(name.value.trim(), storey.value.trim());
      } catch (error) {
        said.textContent = inWords(error);
        save.disabled = false;
      }
    });
    const again = element("button", { type: "button", class: "plain", onclick: () => this.again() }, "Points again");
    const leave = element("button", { type: "button", class: "plain", onclick: () => this.tools.use("none") }, "Cancel");
    return [
      element("strong", {}, "Click to move the nearer point, or save"),
      draft.isNew && element("div", { class: "actions names" }, name, storey),
      element("div", { class: "actions" }, save, again, leave, said),
    ];
  }

  async save(title, storey) {
    const { draft } = this;
    const pins = this.draftPins();
    let plan;
    if (draft.isNew) {
      const id = freeId(title, this.plans);
      const asked = new URLSearchParams({ plan_id: id, display_name: title, ...(storey ? { storey } : {}) });
      for (const { pixel_x, pixel_y, x_m, y_m } of pins) asked.append("pins", [pixel_x, pixel_y, x_m, y_m].join(","));
      plan = await sendFile(`/v1/${this.map}/plans?${asked}`, draft.picture.file);
    } else plan = await send(`/v1/${draft.name}:pin`, { pins });
    this.keep(plan, draft.picture);
    this.draft = null;
    this.tools.use("none");
    await this.show(this.map);
    const saved = this.plans.find(({ name }) => name === plan.name);
    if (saved) this.choose(saved, { shown: true });
    this.render();
  }

  again() {
    const { pixels, ground, ...draft } = this.draft;
    this.tools.use("none");
    this.begin(draft, pixels.map(([pixel_x, pixel_y]) => ({ pixel_x, pixel_y })));
  }

  /** The tool was put away: what was not saved is gone. */
  leave() {
    if (!this.draft) return;
    this.draft = null;
    this.draw();
  }

  say(text) {
    byId("plans-said").textContent = text;
  }
}

const makeOf = (plan) => [plan.created_at_ns, plan.size_bytes, plan.width_px, plan.height_px].join();

const titleOf = (plan) => plan.display_name || lastOf(plan.name);

function scaleOf({ metres_per_pixel: metres }) {
  return metres < 0.1 ? `${(100 * metres).toPrecision(2)} cm` : `${metres.toPrecision(2)} m`;
}

/** An id made of a name that no plan has yet. */
function freeId(title, plans) {
  const taken = new Set(plans.map((plan) => lastOf(plan.name)));
  const base = title.normalize("NFKD").replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^[^A-Za-z0-9]+|[^A-Za-z0-9]+$/g, "").slice(0, 56) || "plan";
  for (let number = 1; ; number += 1) {
    const id = number === 1 ? base : `${base}-${number}`;
    if (!taken.has(id)) return id;
  }
}
