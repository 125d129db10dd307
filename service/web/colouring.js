// The colour of each submap by what is asked about it: its session, height, age, or how well its loop closures fit.
"use strict";

import { Color } from "/vendor/three-0.187.0/three.module.js";
import { inverse, matrixOf, product } from "/frames.js";

/** Dark to light, so that it reads without colours, too (viridis, matplotlib). */
export const RAMP = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
const UNKNOWN = "#8a97a4";

/** A colour of the ramp, 0 to 1. */
export function ramp(share) {
  const at = Math.min(1, Math.max(0, share)) * (RAMP.length - 1);
  const below = Math.min(RAMP.length - 2, Math.floor(at));
  return `#${new Color(RAMP[below]).lerp(new Color(RAMP[below + 1]), at - below).getHexString()}`;
}

/** `values` of submaps by name -> { colours, low, high }; the ends leave out the outermost hundredth. */
function scaled(values) {
  const sorted = [...values.values()].sort((a, b) => a - b);
  const [low, high] = [0.01, 0.99].map((share) => sorted[Math.round(share * (sorted.length - 1))] ?? 0);
  const colours = new Map([...values].map(([name, value]) => [name, ramp(high > low ? (value - low) / (high - low) : 0)]));
  return { colours, low, high, colourOf: (name) => colours.get(name) ?? UNKNOWN };
}

const METRES = (value) => `${value.toFixed(Math.abs(value) < 10 ? 1 : 0)} m`;
const CENTIMETRES = (value) => (value < 1 ? `${Math.round(100 * value)} cm` : METRES(value));

function ageInWords(seconds) {
  const [size, unit] = [[86400, "d"], [3600, "h"], [60, "min"]].find(([limit]) => seconds >= 2 * limit) ?? [1, "s"];
  return `${Math.round(seconds / size)} ${unit} ago`;
}

/** Mean distance between where the loop closures of a submap put it and where it is drawn, metres. */
function residuals(submaps, loops, frame) {
  const poses = new Map();
  for (const submap of submaps) if (submap.t_map_submap && submap.frame === frame) poses.set(submap.name, matrixOf(submap.t_map_submap));
  const sums = new Map();
  for (const loop of loops) {
    const [T_q, T_m] = [poses.get(loop.query), poses.get(loop.match)];
    if (loop.state !== "ACCEPTED" || !T_q || !T_m || !loop.t_match_query) continue;
    const e = product(inverse(matrixOf(loop.t_match_query)), inverse(T_m), T_q).elements;
    const off = Math.hypot(e[12], e[13], e[14]);
    for (const name of [loop.query, loop.match]) {
      const [sum, count] = sums.get(name) ?? [0, 0];
      sums.set(name, [sum + off, count + 1]);
    }
  }
  return new Map([...sums].map(([name, [sum, count]]) => [name, sum / count]));
}

/** The columns of points that colours can tell, by kind: the attribute, the ends of the legend, the title. */
const OF_POINTS = {
  intensity: { attribute: "intensity", legend: ["weak", "strong"], title: "Intensity of the points, each submap by its own range; grey: it was not sent" },
  ring: { attribute: "ring", legend: ["first", "last"], title: "Ring of the points, the laser within its sensor; grey: it was not sent" },
  colour: { attribute: "color", legend: ["", ""], title: "Colour of the points; grey: it was not sent" },
};

/**
 * What `kind` (height, intensity, ring, colour, age, residual) says of submaps: { colourOf, legend: [low, high] in words, low, high };
 * null for "session", whose colours are those of the sessions. Intensity, ring and colour are of points alone: they have no number for a submap.
 */
export function colouring(kind, submaps, loops, frame, heightOf) {
  if (kind === "height") {
    const found = scaled(new Map(submaps.map(({ name }) => [name, heightOf(name)]).filter(([, height]) => height !== undefined)));
    return { ...found, legend: [METRES(found.low), METRES(found.high)], title: "Height", byHeight: true };
  }
  if (OF_POINTS[kind]) return { ...OF_POINTS[kind], colourOf: () => UNKNOWN };
  if (kind === "age") {
    const found = scaled(new Map(submaps.map(({ name, stamp_ns }) => [name, Number(stamp_ns) / 1e9])));
    const newest = Math.max(...submaps.map(({ stamp_ns }) => Number(stamp_ns) / 1e9));
    return { ...found, legend: [ageInWords(newest - found.low), "newest"], title: "When it was taken, before the newest one" };
  }
  if (kind === "residual") {
    const found = scaled(residuals(submaps, loops, frame));
    return { ...found, legend: [CENTIMETRES(found.low), CENTIMETRES(found.high)], title: "How far its loop closures are from the map; grey: none" };
  }
  return null;
}
