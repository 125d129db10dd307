// Where each submap is drawn: in the map's frame where the service gives it, and as the robots' odometry has it.
"use strict";

import { Matrix4, Quaternion, Vector3 } from "/vendor/three-0.187.0/three.module.js";

/** The 4 x 4 matrix of a Transform of the API; the identity where there is none. */
export function matrixOf(transform) {
  if (!transform) return new Matrix4();
  const { translation: t, rotation: r } = transform;
  return new Matrix4().compose(new Vector3(t.x, t.y, t.z), new Quaternion(r.x, r.y, r.z, r.w), new Vector3(1, 1, 1));
}

/** The matrix of a transform in the evidence: four rows of four numbers. */
export function matrixOfRows(rows) {
  return rows ? new Matrix4().set(...rows.flat()) : null;
}

export const product = (...matrices) => matrices.reduce((a, b) => a.clone().multiply(b));
export const inverse = (matrix) => matrix.clone().invert();

/** A pose as the service takes it: x,y,z,qx,qy,qz,qw. */
export function poseText(matrix) {
  const [t, q, s] = [new Vector3(), new Quaternion(), new Vector3()];
  matrix.decompose(t, q, s);
  return [...t.toArray(), ...q.toArray()].join(",");
}

/** The turn of a pose about an axis, a unit vector, radians, -pi to pi. */
export function turnOf(matrix, axis) {
  const { x, y, z, w } = new Quaternion().setFromRotationMatrix(new Matrix4().extractRotation(matrix));
  const turn = 2 * Math.atan2(axis.x * x + axis.y * y + axis.z * z, w);
  return Math.atan2(Math.sin(turn), Math.cos(turn));
}

/** The frame of the map that most submaps have a pose in, the first by its name of several, or null: as the service takes pins. */
export function mainFrame(submaps) {
  const counts = new Map();
  for (const { frame, t_map_submap } of submaps) if (t_map_submap) counts.set(frame, (counts.get(frame) ?? 0) + 1);
  return [...counts].sort(([a, most], [b, more]) => more - most || (a < b ? -1 : 1))[0]?.[0] ?? null;
}

/**
 * T_drawing_odom of each session by name, as one piece each; those that nothing joins with the others are left out.
 * `tracks` is [{ name, submaps }]. A session whose first submap has a pose in `frame` begins there, so that its drift
 * shows from there on; without a frame, the best-scoring loop closures come first.
 */
export function placements(tracks, loops, frame) {
  const placed = new Map();
  for (const { name, submaps } of tracks) {
    const known = submaps.find((submap) => frame !== null && submap.t_map_submap && submap.frame === frame);
    if (known) placed.set(name, product(matrixOf(known.t_map_submap), inverse(matrixOf(known.t_odom_submap))));
  }
  const first = tracks.find((track) => track.submaps.length);
  if (first && !placed.size) placed.set(first.name, new Matrix4());
  return frame === null ? joined(placed, tracks, loops) : placed;
}

function joined(placed, tracks, loops) {
  const poses = new Map();
  const sessionOf = new Map();
  for (const track of tracks) {
    for (const submap of track.submaps) {
      poses.set(submap.name, matrixOf(submap.t_odom_submap));
      sessionOf.set(submap.name, track.name);
    }
  }
  const between = loops
    .filter((loop) => loop.t_match_query && poses.has(loop.query) && poses.has(loop.match))
    .filter((loop) => sessionOf.get(loop.query) !== sessionOf.get(loop.match))
    .sort((a, b) => b.score - a.score);
  for (let grown = true; grown; ) {
    grown = false;
    for (const loop of between) {
      const [query, match] = [sessionOf.get(loop.query), sessionOf.get(loop.match)];
      if (placed.has(query) === placed.has(match)) continue;
      const T_match_query = matrixOf(loop.t_match_query);
      const [T_q, T_m] = [poses.get(loop.query), poses.get(loop.match)];
      if (placed.has(match)) placed.set(query, product(placed.get(match), T_m, T_match_query, inverse(T_q)));
      else placed.set(match, product(placed.get(query), T_q, inverse(T_match_query), inverse(T_m)));
      grown = true;
      break;
    }
  }
  return placed;
}

/** A pose between two others, 0 to 1. */
export function between(from, to, share) {
  if (share <= 0) return from;
  if (share >= 1) return to;
  const [a, b] = [from, to].map((matrix) => {
    const [t, q, s] = [new Vector3(), new Quaternion(), new Vector3()];
    matrix.decompose(t, q, s);
    return { t, q };
  });
  return new Matrix4().compose(a.t.lerp(b.t, share), a.q.slerp(b.q, share), new Vector3(1, 1, 1));
}
