// What the method compared: both submaps from above, with their keypoints and the pairs that the pose brings together.
"use strict";

import { Vector3 } from "/vendor/three-0.187.0/three.module.js";
import { read } from "/api.js";
import { geometryOf } from "/clouds.js";
import { MATCH_COLOUR, QUERY_COLOUR } from "/colours.js";
import { plural } from "/dom.js";
import { inverse, matrixOf, product } from "/frames.js";

const PIXEL_M = 0.4;
const LEAST_REACH_M = 20;
const MOST_REACH_M = 60;
const CELL_M = 4;
const CLEARANCE_M = 0.6;
const LEAST_SHADE = 0.3;
const AGREES = "#4dd6b0";
// From dark to bright, read as more matter above a spot.
const SHADES = [[11, 16, 21], [60, 30, 110], [150, 50, 120], [240, 110, 80], [252, 230, 180]];

/** Draws on a canvas of its own; `load` a loop closure, then `paint`. */
export class KeypointView {
  constructor(canvas) {
    this.canvas = canvas;
    this.shown = null;
  }

  /** Fetch what is drawn of a loop closure; a sentence about it. Raises where the service refuses. */
  async load(loop) {
    const [found, ...clouds] = await Promise.all([
      read(`/v1/${loop.name}/keypoints`),
      ...[loop.query, loop.match].map((name) => geometryOf(name, "points")),
    ]);
    const [query, match] = [found.query, found.match].map((plan, side) => planOf(plan, clouds[side]));
    const pairs = (found.pairs ?? []).map(({ query: a = 0, match: b = 0, agrees = false }) => ({ a, b, agrees }));
    const reach = Math.min(MOST_REACH_M, Math.max(LEAST_REACH_M, reachOf(query), reachOf(match)));
    for (const plan of [query, match]) plan.image = imageOf(plan.standing, reach);
    const turn = loop.t_match_query ? yawOf(product(inverse(match.T_submap_level), matrixOf(loop.t_match_query), query.T_submap_level)) : 0;
    this.shown = { loop: loop.name, query, match, pairs, reach, turn, agreeing: pairs.filter(({ agrees }) => agrees).length };
    return this.sentence();
  }

  sentence() {
    const { query, match, pairs, agreeing } = this.shown;
    const counted = `${plural(query.keypoints.length, "keypoint")} and ${match.keypoints.length}, ${plural(pairs.length, "pair")} alike`;
    return agreeing ? `${counted}, of which the final pose joins ${agreeing}` : `${counted}, none of which the final pose joins`;
  }

  /** `share` 0 shows the query as its robot saw it, 1 turned as the loop closure has it. */
  paint(share) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.shown || !width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.fillStyle = `rgb(${SHADES[0]})`;
    pen.fillRect(0, 0, width, height);
    const { query, match, reach, turn } = this.shown;
    const size = Math.min(width / 2 - 12, height - 90);
    const scale = size / (2 * reach);
    const places = [
      { plan: query, colour: QUERY_COLOUR, x: width / 4, yaw: share * turn },
      { plan: match, colour: MATCH_COLOUR, x: (3 * width) / 4, yaw: 0 },
    ].map((one) => ({ ...one, y: height / 2, scale, size }));
    for (const place of places) paintPlan(pen, place);
    this.paintPairs(pen, places);
  }

  paintPairs(pen, [query, match]) {
    pen.lineWidth = 1;
    pen.strokeStyle = AGREES;
    for (const { a, b, agrees } of this.shown.pairs) {
      if (!agrees) continue;
      pen.globalAlpha = 0.55;
      pen.beginPath();
      pen.moveTo(...spot(query, query.plan.keypoints[a]));
      pen.lineTo(...spot(match, match.plan.keypoints[b]));
      pen.stroke();
      pen.globalAlpha = 1;
      for (const at of [spot(query, query.plan.keypoints[a]), spot(match, match.plan.keypoints[b])]) circle(pen, at, 3.4, AGREES, true);
    }
  }
}

function planOf(plan, geometry) {
  const T_submap_level = matrixOf(plan.t_submap_level);
  const keypoints = (plan.x ?? []).map((x, index) => [x, plan.y[index]]);
  return { keypoints, T_submap_level, standing: standing(geometry, inverse(T_submap_level)) };
}

const yawOf = (matrix) => Math.atan2(matrix.elements[1], matrix.elements[0]);

const reachOf = ({ keypoints }) => 1.1 * Math.max(0, ...keypoints.map(([x, y]) => Math.hypot(x, y)));

/** The points above the ground as [x, y, x, y, ...] in the upright frame. */
function standing(geometry, T_level_submap) {
  const positions = geometry.getAttribute("position");
  const points = [];
  const lowest = new Map();
  for (let at = 0, point = new Vector3(); at < positions.count; at += 1) {
    point.fromBufferAttribute(positions, at).applyMatrix4(T_level_submap);
    const cell = `${Math.floor(point.x / CELL_M)},${Math.floor(point.y / CELL_M)}`;
    if (!(lowest.get(cell) < point.z)) lowest.set(cell, point.z);
    points.push({ x: point.x, y: point.y, z: point.z, cell });
  }
  return points.filter(({ z, cell }) => z > lowest.get(cell) + CLEARANCE_M).flatMap(({ x, y }) => [x, y]);
}

/** How much stands above each spot, as a picture; x to the right, y up. */
function imageOf(points, reach) {
  const size = Math.ceil((2 * reach) / PIXEL_M);
  const counts = new Float32Array(size * size);
  for (let at = 0; at < points.length; at += 2) {
    const [column, row] = [Math.floor((points[at] + reach) / PIXEL_M), Math.floor((reach - points[at + 1]) / PIXEL_M)];
    if (column >= 0 && row >= 0 && column < size && row < size) counts[row * size + column] += 1;
  }
  const levels = counts.map(Math.log1p);
  const occupied = levels.filter((level) => level > 0).sort();
  const brightest = occupied[Math.floor(0.8 * (occupied.length - 1))] || 1;
  const image = new ImageData(size, size);
  levels.forEach((level, index) => image.data.set([...shade(level && LEAST_SHADE + (1 - LEAST_SHADE) * Math.min(1, level / brightest)), 255], 4 * index));
  const canvas = new OffscreenCanvas(size, size);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

function shade(share) {
  const at = share * (SHADES.length - 1);
  const [low, high] = [SHADES[Math.floor(at)], SHADES[Math.ceil(at)]];
  return low.map((value, channel) => value + (high[channel] - value) * (at - Math.floor(at)));
}

function paintPlan(pen, place) {
  const { plan, x, y, yaw, size, colour } = place;
  pen.save();
  pen.beginPath();
  pen.rect(x - size / 2, y - size / 2, size, size);
  pen.clip();
  pen.translate(x, y);
  pen.rotate(-yaw);
  pen.drawImage(plan.image, -size / 2, -size / 2, size, size);
  pen.restore();
  for (const keypoint of plan.keypoints) circle(pen, spot(place, keypoint), 2.4, colour, false);
}

/** Where a keypoint is drawn. */
function spot({ x, y, yaw, scale }, [along, up]) {
  const [cosine, sine] = [Math.cos(yaw), Math.sin(yaw)];
  return [x + scale * (cosine * along - sine * up), y - scale * (sine * along + cosine * up)];
}

function circle(pen, [x, y], radius, colour, filled) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen[filled ? "fillStyle" : "strokeStyle"] = colour;
  pen[filled ? "fill" : "stroke"]();
}
