// Why a submap has no loop closure: the pairs that came nearest, with the check that stopped each.
"use strict";

import { element, shortName } from "/dom.js";
import { measures, verdictOf } from "/words.js";

const TOLD = 8;

/** The rows for the rejected ones of `loops` that a submap is in, those that came nearest first; `onOpen` opens one. */
export function nearMisses(submap, loops, onOpen) {
  const own = loops.filter((loop) => loop.state === "REJECTED" && [loop.query, loop.match].includes(submap));
  own.sort((a, b) => b.score - a.score || b.similarity - a.similarity);
  return own.length ? own.slice(0, TOLD).map((loop) => row(loop, submap, onOpen)) : [element("li", { class: "nothing" }, "No other submap was like enough to be compared")];
}

function row(loop, submap, onOpen) {
  const other = loop.query === submap ? loop.match : loop.query;
  return element("li", {}, element("button", { type: "button", onclick: () => onOpen(loop.name) }, element("i", { class: "sign rejected" }), element("span", {}, shortName(other)), element("small", {}, [verdictOf(loop), missed(loop)].filter(Boolean).join(" \u00b7 "))));
}

/** The first number that did not reach its threshold, in words. */
function missed(loop) {
  const found = measures(loop).find(([, value, limit, more]) => limit !== null && (more ? value < limit : value > limit));
  return found ? `${found[0].toLowerCase()} ${found[1].toFixed(2)}, needs ${found[3] ? "at least" : "at most"} ${found[2].toFixed(2)}` : "";
}
