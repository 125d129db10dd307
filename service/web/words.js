// What was measured, in words.
"use strict";

const REASONS = {
  DEGENERATE_PLACE: ["Too little to recognise", "One of the two places has too little structure above the ground, or all of it on one line. Nothing can tell such a place from another; longer submaps see more."],
  NO_COMMON_REGION: ["Nothing in common", "No pose was found in which both submaps have seen enough of the same region. Mostly these are two different places, as they should be."],
  DEGENERATE_ALIGNMENT: ["Slides along", "The surfaces fit, but can slide along each other, as in a tunnel or a long straight street. The pose in that direction would be a guess."],
  IMPLAUSIBLE_TILT: ["Tilted", "The pose tilts one submap against the other although both are levelled by their odometry. The match is wrong, or the z axis of the odometry does not point up."],
  LOW_OVERLAP: ["Too little overlap", "After the best alignment too little of the surfaces coincides."],
  SEEN_THROUGH: ["Seen through", "In this pose one place has walls where the other has looked into the distance. Mostly these are two places that resemble each other."],
  LOW_SCORE: ["Not convincing", "Every check was passed, but the evidence as a whole does not convince."],
  AMBIGUOUS: ["Other poses fit as well", "Every check was passed, but other poses, metres away or turned, fit about as well: the next bay, the next aisle, identical houses. Geometry alone cannot tell which one is right."],
  AWAITS_CHAIN: ["Waits for the drive", "Every check was passed, but places may repeat here. It is accepted once the drive has gone on and nothing contradicts it."],
  OVERRULED: ["By a person", "A person has rejected it; what was measured is below."],
  PLACE_LOST: ["Data lost", "The stored data of the candidate are damaged, so it could not be compared."],
};

/** A map by its name for people and its id, and by its profile where that is not the product's. */
export function titleOf(map) {
  const id = map.name.split("/").at(-1);
  const title = map.display_name ? `${map.display_name} (${id})` : id;
  return map.profile && map.profile !== "product" ? `${title}, profile ${map.profile}` : title;
}

/** accepted, ambiguous or rejected: how the page shows a loop closure. */
export function stateOf(loop) {
  if (loop.state === "ACCEPTED") return "accepted";
  if (loop.state === "PROPOSED") return "ambiguous";
  return loop.reason === "AMBIGUOUS" ? "ambiguous" : "rejected";
}

const FAULTS = { SLIP: "slip", JUMP: "jump", TURN: "turn", TILT: "tilt", SCALE: "scale off by", SLOPE: "slope", HEADING: "heading" };
const DEGREES = 180 / Math.PI;

/** A fault of odometry in a few words: `slip 4.9 m`. */
export function faultOf({ kind, amount, undecided }) {
  const size = Math.abs(amount);
  const sizes = { SLIP: `${size.toFixed(1)} m`, JUMP: `${size.toFixed(1)} m`, HEADING: `${(size * DEGREES).toFixed(2)}\u00b0/m`, SCALE: `${(100 * size).toFixed(1)} %`, SLOPE: `${(100 * size).toFixed(1)} %` };
  return `${FAULTS[kind] ?? kind.toLowerCase()} ${sizes[kind] ?? `${(size * DEGREES).toFixed(1)}\u00b0`}${undecided ? "?" : ""}`;
}

/** A few words for a list. */
export function verdictOf(loop) {
  const state = stateOf(loop);
  if (state === "accepted") return loop.graph_state === "SET_ASIDE" ? "Accepted, but set aside by the map" : "Accepted";
  if (loop.reason === "AWAITS_CHAIN") return REASONS.AWAITS_CHAIN[0];
  if (loop.state === "PROPOSED") return "Proposed by a person";
  const reason = REASONS[loop.reason]?.[0] ?? loop.reason.toLowerCase().replaceAll("_", " ");
  return state === "ambiguous" ? "Ambiguous" : `Rejected: ${reason.toLowerCase()}`;
}

const percent = (share) => `${Math.round(100 * share)} %`;

const ANCHOR_REASONS = {
  DISAGREES: "drive and others put it elsewhere",
  TOO_FEW: "fewer than four anchors agree",
  NOT_SPREAD: "they lie too near each other to tell the heading of the map",
  MOSTLY_DISAGREE: "fewer than half agree",
  MISREAD: "the tag was read for another one",
  MOVED: "other passes see the tag elsewhere",
  TWO_PLACES: "the tag hangs at two places",
  SEEN_ONCE: "no other pass has seen the tag",
  NOT_JOINED: "the tag is in another frame, too, and no loop joins them",
};

/** Why an anchor does not hold the map, in words. */
export const anchorReason = (reason) => ANCHOR_REASONS[reason] ?? reason.toLowerCase().replaceAll("_", " ");

/** A length in words: 12 cm, 3.4 m, 31 m. */
export function metres(length) {
  if (length < 0.995) return `${Math.max(1, Math.round(100 * length))} cm`;
  return `${length.toFixed(length < 10 ? 1 : 0)} m`;
}

/** Sentences that say why the verdict is what it is. */
export function sentences(loop) {
  const measured = loop.evidence?.measurement ?? {};
  const said = [];
  if (loop.state === "ACCEPTED") said.push(loop.manual ? "A person says that both submaps show the same place." : "Both submaps show the same place.");
  else if (loop.state === "PROPOSED" && loop.reason !== "AWAITS_CHAIN") said.push("A person has found it; it waits to be verified.");
  else said.push(REASONS[loop.reason]?.[1] ?? `Rejected: ${loop.reason}.`);
  if (measured.overlap !== undefined && measured.overlap !== null) {
    const residual = measured.rmse_m ? `, ${metres(measured.rmse_m)} apart on average` : "";
    said.push(`${percent(measured.overlap)} of the surface lies on the other one${residual}.`);
  }
  if (measured.seen_through !== undefined && measured.seen_through !== null) {
    said.push(
      measured.seen_through < 0.02
        ? "Neither place has looked through what stands in the other."
        : `${percent(measured.seen_through)} of what stands in one place was looked through by the other.`,
    );
  }
  if (measured.inliers) said.push(`${measured.inliers} keypoints agree on a first guess of the pose.`);
  const pose = precision(measured.covariance);
  if (pose && loop.state === "ACCEPTED") said.push(`The pose is known to about ${pose}.`);
  if (loop.graph_state === "SET_ASIDE") said.push("It does not fit the other loop closures or the surfaces of the map, so the map does not rest on it.");
  if (loop.graph_state === "UNCONNECTED") said.push("Too few loop closures join its two sessions: they share no frame yet.");
  const rivals = measured.rivals?.length ?? 0;
  if (rivals) said.push(rivals === 1 ? "One other pose fits about as well." : `${rivals} other poses fit about as well.`);
  const support = loop.evidence?.support;
  if (support) said.push(`By itself ambiguous: ${support.words}.`);
  const spots = loop.evidence?.distinctiveness?.other_spots ?? 0;
  if (spots) said.push(`It would pass at ${spots === 1 ? "one other spot" : `${spots} other spots`} of the same drive, too.`);
  return said;
}

/** One standard deviation of a covariance in words, or null. */
function precision(covariance) {
  if (!covariance) return null;
  const horizontal = Math.sqrt(Math.max(covariance[0][0], covariance[1][1]));
  const yaw = (Math.sqrt(covariance[5][5]) * 180) / Math.PI;
  return Number.isFinite(horizontal) ? `${metres(horizontal)} and ${yaw.toFixed(yaw < 1 ? 2 : 1)}\u00b0` : null;
}

/** What is shown as bars: [name, value 0..1, threshold or null, whether more is better, help]. */
export function measures(loop) {
  const measured = loop.evidence?.measurement ?? {};
  const limits = loop.evidence?.thresholds ?? {};
  return [
    ["Score", loop.score, limits.min_score ?? null, true, "All of the evidence as one number"],
    ["Overlap", measured.overlap, limits.min_overlap ?? null, true, "Share of the surface that lies on the other one"],
    ["Seen through", measured.seen_through, limits.max_seen_through ?? null, false, "Share of what stands here that the other has looked through"],
    ["Similarity", loop.similarity, null, true, "Of the descriptors; it chose the candidate and decides nothing else"],
  ].filter(([, value]) => value !== undefined && value !== null);
}

/** Rival poses of an ambiguous loop closure: [{ overlap, rows }], best first. */
export function rivalsOf(loop) {
  const measured = loop.evidence?.measurement ?? {};
  return (measured.rivals ?? []).map((rival) => ({ overlap: rival.overlap, rows: rival.T_match_query }));
}

/** The distance and the turn of one pose from another, in words. */
export function apart(difference) {
  const e = difference.elements;
  const turn = Math.abs((Math.atan2(e[1], e[0]) * 180) / Math.PI);
  const distance = Math.hypot(e[12], e[13], e[14]);
  return `${metres(distance)} away${turn > 2 ? `, turned by ${Math.round(turn)}\u00b0` : ""}`;
}
