// The canvas: sessions as coloured lines of submaps, loop closures across them, a grid and a scale in metres.
"use strict";

import { compose, placements, planar } from "/placement.js";

export const SESSION_COLOURS = ["#1c7ed6", "#9c36b5", "#0ca678", "#c2255c", "#5c940d", "#3b5bdb"];
const MARGIN = 36;
const NEAR_PX = 14;

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function extent(values) {
  return values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
}

function projection(points, width, height) {
  const [x0, x1] = extent(points.map((point) => point.x));
  const [y0, y1] = extent(points.map((point) => point.y));
  const scale = Math.min((width - 2 * MARGIN) / Math.max(x1 - x0, 5), (height - 2 * MARGIN) / Math.max(y1 - y0, 5));
  const place = (point) => [
    width / 2 + (point.x - (x0 + x1) / 2) * scale,
    height / 2 - (point.y - (y0 + y1) / 2) * scale,
  ];
  return { place, scale };
}

function roundMetres(atLeast) {
  const power = 10 ** Math.floor(Math.log10(atLeast));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= atLeast);
}

function stroke(context, points, colour, width, alpha = 1) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.globalAlpha = alpha;
  context.beginPath();
  points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
  context.globalAlpha = 1;
}

function disc(context, [x, y], radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}

function drawGrid(context, width, height, { place, scale }) {
  const step = roundMetres(70 / scale) * scale;
  const [x0, y0] = place({ x: 0, y: 0 });
  for (let x = x0 % step; x < width; x += step) stroke(context, [[x, 0], [x, height]], style("--grid"), 1);
  for (let y = y0 % step; y < height; y += step) stroke(context, [[0, y], [width, y]], style("--grid"), 1);
}

function drawScale(context, width, height, scale) {
  const metres = roundMetres(60 / scale);
  const [right, y] = [width - 16, height - 14];
  stroke(context, [[right - metres * scale, y], [right, y]], style("--soft"), 2);
  context.fillStyle = style("--soft");
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "right";
  context.fillText(`${metres} m`, right, y - 6);
}

/** The loops to draw: all, or the best-scoring one of each query submap. */
export function bestLoops(loops) {
  const best = new Map();
  for (const loop of loops) {
    if (!best.has(loop.query) || best.get(loop.query).score < loop.score) best.set(loop.query, loop);
  }
  return [...best.values()];
}

/** A drawing on a canvas: give it a map with `show`; it redraws itself when its size or the theme changes. */
export class Drawing {
  constructor(canvas) {
    this.canvas = canvas;
    this.map = { tracks: [], loops: [] };
    this.highlighted = null;
    new ResizeObserver(() => this.draw()).observe(canvas);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  /** How many tracks could not be placed beside the first, because no loop closure leads to them. */
  show(map) {
    this.map = map;
    const placed = placements(map.tracks, map.loops);
    this.points = map.tracks.map((track, index) =>
      placed[index] ? track.map((submap) => compose(placed[index], planar(submap.t_odom_submap))) : [],
    );
    this.draw();
    return map.tracks.filter((track, index) => track.length && !placed[index]).length;
  }

  highlight(loop) {
    this.highlighted = loop;
    this.draw();
  }

  /** The drawn submap within reach of a point of the canvas, or null. */
  nearest(x, y) {
    let found = null;
    let reach = NEAR_PX;
    for (const { submap, at } of this.marks ?? []) {
      const distance = Math.hypot(at[0] - x, at[1] - y);
      if (distance < reach) [found, reach] = [submap, distance];
    }
    return found;
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.lineJoin = context.lineCap = "round";
    const points = (this.points ?? []).flat();
    if (!points.length) return;
    const view = projection(points, width, height);
    drawGrid(context, width, height, view);
    this.marks = this.map.tracks.flatMap((track, index) =>
      this.points[index].map((point, at) => ({ submap: track[at], at: view.place(point), track: index })),
    );
    this.drawTracks(context);
    this.drawLoops(context);
    drawScale(context, width, height, view.scale);
  }

  drawTracks(context) {
    const radius = this.marks.length > 400 ? 2 : 3.2;
    this.map.tracks.forEach((_, index) => {
      const colour = SESSION_COLOURS[index % SESSION_COLOURS.length];
      const marks = this.marks.filter((mark) => mark.track === index);
      stroke(context, marks.map((mark) => mark.at), colour, 1.5, 0.55);
      const colours = { DESCRIBED: colour, QUEUED: style("--waiting"), FAILED: style("--failed") };
      // What waits goes first: where a robot drives a street again, what is done lies above it, and failures above all.
      const rank = (mark) => ["QUEUED", "DESCRIBED", "FAILED"].indexOf(mark.submap.state);
      for (const { submap, at } of [...marks].sort((a, b) => rank(a) - rank(b))) {
        disc(context, at, radius, colours[submap.state]);
      }
    });
  }

  drawLoops(context) {
    const where = new Map(this.marks.map((mark) => [mark.submap.name, mark.at]));
    const line = (loop, width, alpha) => {
      const ends = [where.get(loop.query), where.get(loop.match)];
      if (!ends.every(Boolean)) return;
      stroke(context, ends, style("--loop"), width, alpha);
      // Ends too close to draw a line between: the same place on top of itself.
      for (const end of ends) disc(context, end, width * 1.1 + 0.6, style("--loop"));
    };
    const alpha = Math.max(0.15, Math.min(0.8, 150 / Math.max(this.map.loops.length, 1)));
    for (const loop of this.map.loops) line(loop, 1.5, alpha);
    if (this.highlighted) line(this.highlighted, 4, 1);
  }
}
