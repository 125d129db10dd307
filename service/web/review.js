// Accepting, rejecting and reverting loop closures, for those whose key may administer.
"use strict";

/** The buttons that a loop closure offers; none as long as the service has no such calls. */
export function actionsOf() {
  return [];
}
