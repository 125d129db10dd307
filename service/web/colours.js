// Colours that people with any kind of colour vision tell apart (Paul Tol's bright and vibrant schemes).
"use strict";

const SESSIONS = ["#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", "#EE7733", "#009988"];

/** The colour of the n-th session of a map. */
export const sessionColour = (index) => SESSIONS[index % SESSIONS.length];

export const QUERY_COLOUR = "#EE7733";
export const MATCH_COLOUR = "#3B8EDB";

/** A colour of the page's theme. */
export const themed = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
