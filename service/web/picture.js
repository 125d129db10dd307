// The dialog in which two points of a picture are clicked: larger or smaller, moved by the finger or the scroll bars.
"use strict";

import { byId, element } from "/dom.js";

const MOST_ZOOM = 16;
const THUMB = 96;

export class PicturePins {
  constructor() {
    this.points = [];
    this.zoom = 1;
    byId("plan-picture").addEventListener("click", ({ offsetX, offsetY }) => this.take(offsetX, offsetY));
    byId("plan-larger").addEventListener("click", () => this.zoomTo(2 * this.zoom));
    byId("plan-smaller").addEventListener("click", () => this.zoomTo(this.zoom / 2));
    byId("plan-again").addEventListener("click", () => this.show([]));
    byId("plan-next").addEventListener("click", () => byId("plan-dialog").close("next"));
    byId("plan-cancel").addEventListener("click", () => byId("plan-dialog").close(""));
    byId("plan-dialog").addEventListener("close", () => this.answer?.(byId("plan-dialog").returnValue === "next" ? this.points : null));
    window.addEventListener("resize", () => byId("plan-dialog").open && this.zoomTo(this.zoom));
  }

  /** Two points of a picture, pixels, of which some may be known; null where the dialog was left. */
  ask(title, picture, points = []) {
    this.picture = picture;
    byId("plan-title").textContent = title;
    const canvas = byId("plan-picture");
    Object.assign(canvas, { width: picture.image.width, height: picture.image.height });
    canvas.getContext("2d").drawImage(picture.image, 0, 0);
    byId("plan-dialog").returnValue = "";
    byId("plan-dialog").showModal();
    this.zoomTo(1);
    this.show(points);
    return new Promise((resolve) => (this.answer = resolve));
  }

  /** So many times as large as it fits; what is in the middle stays there. */
  zoomTo(zoom) {
    const [pane, sheet] = [byId("plan-pane"), byId("plan-sheet")];
    const [x, y] = [(pane.scrollLeft + pane.clientWidth / 2) / (sheet.clientWidth || 1), (pane.scrollTop + pane.clientHeight / 2) / (sheet.clientHeight || 1)];
    this.zoom = Math.min(MOST_ZOOM, Math.max(1, zoom));
    const { width, height } = this.picture;
    const fit = Math.min(pane.clientWidth / width, pane.clientHeight / height);
    sheet.style.width = `${Math.round(fit * this.zoom * width)}px`;
    sheet.style.height = `${Math.round(fit * this.zoom * height)}px`;
    pane.scrollTo(x * sheet.clientWidth - pane.clientWidth / 2, y * sheet.clientHeight - pane.clientHeight / 2);
    byId("plan-smaller").disabled = this.zoom === 1;
    byId("plan-larger").disabled = this.zoom === MOST_ZOOM;
  }

  take(x, y) {
    const { clientWidth, clientHeight } = byId("plan-picture");
    const at = [(x / clientWidth) * this.picture.width, (y / clientHeight) * this.picture.height];
    if (this.points.length < 2) return this.show([...this.points, at]);
    const [one, other] = this.points.map((point) => Math.hypot(point[0] - at[0], point[1] - at[1]));
    return this.show(one <= other ? [at, this.points[1]] : [this.points[0], at]);
  }

  show(points) {
    this.points = points;
    const marks = points.map(([x, y], index) => {
      const mark = element("i", { class: "pin" }, element("b", {}, String(index + 1)));
      mark.style.left = `${(100 * x) / this.picture.width}%`;
      mark.style.top = `${(100 * y) / this.picture.height}%`;
      return mark;
    });
    byId("plan-marks").replaceChildren(...marks);
    byId("plan-next").disabled = points.length < 2;
    byId("plan-hint").textContent = ["Click a point that you find again in the map", "And a second one, far from the first", "Both are set. Click to move the nearer one"][points.length];
  }

  /** A small canvas of what lies around a point of a picture. */
  thumbnail({ image, width }, [x, y]) {
    const canvas = element("canvas", { width: 2 * THUMB, height: 2 * THUMB, "aria-hidden": "true" });
    const share = image.width / width;
    const reach = Math.max(40, Math.min(image.width, image.height) / 8);
    canvas.getContext("2d").drawImage(image, x * share - reach, y * share - reach, 2 * reach, 2 * reach, 0, 0, 2 * THUMB, 2 * THUMB);
    return canvas;
  }
}
