// Where each session is drawn: in the map's frame where the service gives it, else placed by its best loop closure.
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

/**
 * T_drawing_odom of each session by name; those that no loop closure joins with the first one are left out.
 * `tracks` is [{ name, T_map_odom, submaps }]. The best-scoring loops come first. This places whole sessions for the
 * eye; within one of them nothing is corrected.
 */
export function placements(tracks, loops) {
  const poses = new Map();
  const sessionOf = new Map();
  for (const track of tracks) {
    for (const submap of track.submaps) {
      poses.set(submap.name, matrixOf(submap.t_odom_submap));
      sessionOf.set(submap.name, track.name);
    }
  }
  const placed = new Map();
  for (const track of tracks) if (track.T_map_odom && track.submaps.length) placed.set(track.name, matrixOf(track.T_map_odom));
  const first = tracks.find((track) => track.submaps.length);
  if (first && !placed.size) placed.set(first.name, new Matrix4());
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
