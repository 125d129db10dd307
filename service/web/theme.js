// Set before the first paint: the theme that was chosen, else that of the system.
"use strict";

(() => {
  const chosen = localStorage.getItem("revisit-theme");
  if (chosen) document.documentElement.dataset.theme = chosen;
})();
