// Where each session is drawn: sessions have odometry frames of their own, and loop closures say how those lie.
"use strict";

/** A planar motion { x, y, yaw } from a transform of the API. */
export function planar(transform) {
  const { x, y, z, w } = transform.rotation;
  const yaw = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  return { x: transform.translation.x, y: transform.translation.y, yaw };
}

/** The motion a after b: T_a_c = T_a_b @ T_b_c. */
export function compose(a, b) {
  const [cosine, sine] = [Math.cos(a.yaw), Math.sin(a.yaw)];
  return { x: a.x + cosine * b.x - sine * b.y, y: a.y + sine * b.x + cosine * b.y, yaw: a.yaw + b.yaw };
}

export function inverse(a) {
  const [cosine, sine] = [Math.cos(a.yaw), Math.sin(a.yaw)];
  return { x: -cosine * a.x - sine * a.y, y: sine * a.x - cosine * a.y, yaw: -a.yaw };
}

/**
 * T_drawing_odom of each track, in their order; undefined where no loop leads to the first one.
 * The best-scoring loops come first; drift is not corrected, this places whole sessions for the eye only.
 */
export function placements(tracks, loops) {
  const trackOf = new Map();
  const poses = new Map();
  tracks.forEach((track, index) =>
    track.forEach((submap) => {
      trackOf.set(submap.name, index);
      poses.set(submap.name, planar(submap.t_odom_submap));
    }),
  );
  const between = loops
    .filter((loop) => loop.t_match_query && trackOf.has(loop.query) && trackOf.has(loop.match))
    .filter((loop) => trackOf.get(loop.query) !== trackOf.get(loop.match))
    .sort((a, b) => b.score - a.score);
  const placed = tracks.map(() => undefined);
  const first = tracks.findIndex((track) => track.length);
  if (first >= 0) placed[first] = { x: 0, y: 0, yaw: 0 };
  for (let grown = true; grown; ) {
    grown = false;
    for (const loop of between) {
      const [query, match] = [trackOf.get(loop.query), trackOf.get(loop.match)];
      if (Boolean(placed[query]) === Boolean(placed[match])) continue;
      const T_match_query = planar(loop.t_match_query);
      const [poseQuery, poseMatch] = [poses.get(loop.query), poses.get(loop.match)];
      if (placed[match]) {
        placed[query] = compose(compose(compose(placed[match], poseMatch), T_match_query), inverse(poseQuery));
      } else {
        placed[match] = compose(compose(compose(placed[query], poseQuery), inverse(T_match_query)), inverse(poseMatch));
      }
      grown = true;
      break;
    }
  }
  return placed;
}
