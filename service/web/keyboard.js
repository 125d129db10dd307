// What the keys do.
"use strict";

import { byId, element } from "/dom.js";

/** Listen to keys: `commands` is [[keys, what it does, work, in the dialog of a loop closure too]]. */
export function listen(commands, isOpen) {
  byId("help-keys").replaceChildren(
    ...commands.flatMap(([keys, help]) => [
      element("dt", {}, ...keys.map((key) => element("kbd", {}, key === " " ? "space" : key))),
      element("dd", {}, help),
    ]),
  );
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input:not([type=range]), select, textarea");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) {
      if (typing && event.key === "Escape") event.target.blur();
      return;
    }
    const command = commands.find(([keys]) => keys.includes(event.key));
    if (!command || (isOpen() && !command[3])) return;
    if ([" ", "Enter"].includes(event.key) && event.target.closest("button, summary, a")) return; // it is pressed itself
    event.preventDefault();
    command[2]();
  });
}
