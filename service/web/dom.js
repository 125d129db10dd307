// Small pieces of the page. Text only ever enters it as textContent.
"use strict";

export const byId = (id) => document.getElementById(id);

/** A new element: `element("p", { class: "note", title: "..." }, "text", child, ...)`. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "colour") made.style.setProperty("--colour", value);
    else if (name === "share") made.style.setProperty("--share", String(value));
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

export const plural = (count, word) => `${count.toLocaleString("en")} ${word}${count === 1 ? "" : "s"}`;

/** `monday/a` of `maps/town/sessions/monday/submaps/a`. */
export function shortName(name) {
  return name.split("/").filter((_, index) => index % 2 === 1).slice(1).join(" / ");
}

export const lastOf = (name) => name.slice(name.lastIndexOf("/") + 1);

export const sessionOf = (submap) => submap.split("/").slice(0, 4).join("/");

/** Mark one button of a group as the pressed one. */
export function press(group, attribute, value) {
  for (const button of group.querySelectorAll(`[data-${attribute}]`)) {
    button.setAttribute("aria-pressed", String(button.dataset[attribute] === value));
  }
}

/** Call `work` once, soon after the last of many calls. */
export function soon(work, delay_ms = 60) {
  let timer = 0;
  return () => {
    if (timer) return;
    timer = setTimeout(() => {
      timer = 0;
      work();
    }, delay_ms);
  };
}

/** Fill a list anew; the keyboard stays where it was, on what has the same id, or the same words or place in the row of the same name. */
export function refill(list, ...rows) {
  const focused = list.contains(document.activeElement) ? document.activeElement : null;
  const row = focused?.closest("[data-name]");
  const place = row ? controlsOf(row).indexOf(focused) : -1;
  list.replaceChildren(...rows);
  const now = row && controlsOf([...list.children].find(({ dataset }) => dataset.name === row.dataset.name));
  const again = focused?.id ? byId(focused.id) : (now?.find(({ textContent }) => textContent && textContent === focused.textContent) ?? now?.[place]);
  again?.focus({ preventScroll: true });
}

const controlsOf = (row) => [...(row?.querySelectorAll("button, input") ?? [])];
