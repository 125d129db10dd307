// Accepting, rejecting and taking back: for those whose key may administer. And what happened to a loop closure before.
"use strict";

import { KeyNeeded, Refused, readAll, send } from "/api.js";
import { element } from "/dom.js";

const WORDS = { VERIFIED: "verified", PROPOSED: "proposed", ACCEPTED: "accepted", REJECTED: "rejected", REVERTED: "decision taken back" };

/** The buttons that a loop closure offers, and its history; `taken` hears of it as it is after a decision. */
export function actionsOf(loop, taken) {
  const note = element("input", { type: "text", placeholder: "Why? (noted with your decision)", maxlength: 256, "aria-label": "Why" });
  const said = element("p", { role: "alert", hidden: true });
  const decide = (decision) => async (event) => {
    event.target.disabled = true;
    said.hidden = true;
    try {
      taken(await send(`/v1/${loop.name}:${decision}`, { note: note.value }));
    } catch (error) {
      said.textContent = inWords(error);
      said.hidden = false;
      event.target.disabled = false;
    }
  };
  const history = element("ol", { class: "history" });
  const back = element("button", { type: "button", class: "plain", onclick: decide("revert"), hidden: true }, "Take back");
  tellHistory(loop, history, back);
  return [
    element("h3", {}, "Decide"),
    element(
      "div",
      { class: "actions" },
      note,
      loop.state !== "ACCEPTED" && element("button", { type: "button", onclick: decide("accept") }, "Accept"),
      loop.state !== "REJECTED" && element("button", { type: "button", class: loop.state === "ACCEPTED" ? null : "plain", onclick: decide("reject") }, "Reject"),
      back,
      said,
    ),
    history,
  ];
}

function inWords(error) {
  if (error instanceof KeyNeeded) return "An API key is needed";
  if (error instanceof Refused && error.status === 403) return "This key may look, but not decide: that needs the scope admin.";
  return error.message;
}

/** Who did what to a loop closure; `back` is offered where a decision holds. */
async function tellHistory(loop, history, back) {
  const events = await readAll(`/v1/${loop.name}/events`, "loop_closure_events").catch(() => []);
  const told = events.filter((event) => event.kind in WORDS);
  const holding = told.reduce((count, { kind }) => Math.max(0, count + ({ ACCEPTED: 1, REJECTED: 1, REVERTED: -1 }[kind] ?? 0)), 0);
  back.hidden = !holding;
  history.replaceChildren(...told.slice(-6).reverse().map(entry));
}

function entry(event) {
  const when = new Date(Number(event.at_ns) / 1e6).toLocaleString();
  const start = event.details?.start ? ", from where it was put by hand" : "";
  return element("li", {}, `${WORDS[event.kind]} by ${event.actor || "nobody known"}${start}`, element("small", {}, event.note ? `${when}: ${event.note}` : when));
}
