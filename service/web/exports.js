// Exports that the page makes by itself, as files of the browser; those of the command line it names.
"use strict";

import { readFile } from "/api.js";
import { byId, lastOf } from "/dom.js";

/** Offer a file to the person. */
export function save(name, content, type = "text/plain") {
  const address = URL.createObjectURL(new Blob([content], { type }));
  const link = Object.assign(document.createElement("a"), { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/** Poses of the map in `frame` as TUM: seconds, x, y, z, and the quaternion x, y, z, w. */
export function posesAsTum(submaps, frame) {
  const rows = submaps
    .filter((submap) => submap.t_map_submap && submap.frame === frame)
    .sort((a, b) => (BigInt(a.stamp_ns) < BigInt(b.stamp_ns) ? -1 : 1))
    .map(({ stamp_ns, t_map_submap: { translation: t, rotation: r } }) => [secondsOf(stamp_ns), t.x, t.y, t.z, r.x, r.y, r.z, r.w].join(" "));
  return `${rows.join("\n")}\n`;
}

function secondsOf(stamp_ns) {
  const text = String(stamp_ns).padStart(10, "0");
  return `${text.slice(0, -9)}.${text.slice(-9)}`;
}

/** The loop closures that are listed, one a line. */
export function loopsAsCsv(loops) {
  const rows = loops.map((loop) => {
    const { translation: t, rotation: r } = loop.t_match_query ?? { translation: {}, rotation: {} };
    return [lastOf(loop.name), loop.query, loop.match, loop.state, loop.reason ?? "", loop.graph_state ?? "", loop.score, t.x, t.y, t.z, r.x, r.y, r.z, r.w].map((value) => value ?? "").join(",");
  });
  return `loop,query,match,state,reason,graph_state,score,x,y,z,qx,qy,qz,qw\n${rows.join("\n")}\n`;
}

/** The cloud or the surface of one submap as the service has it. */
export async function saveSubmap(submap, format) {
  save(`${lastOf(submap)}.${format}`, await readFile(`/v1/${submap}:download?format=${format}`), "application/octet-stream");
}

/** Wire the buttons; `told()` gives { map, submaps, loops, frame } as the page shows them. */
export function connectExports(told) {
  byId("exports").addEventListener("click", ({ target }) => {
    const { map, submaps, loops, frame } = told();
    byId("export-said").textContent = "";
    if (target.dataset.format === "csv") save(`${lastOf(map)}-loops.csv`, loopsAsCsv(loops), "text/csv");
    if (target.dataset.format !== "tum") return;
    if (frame === null) byId("export-said").textContent = "No version of the map yet: revisit map optimise";
    else save(`${lastOf(map)}.tum`, posesAsTum(submaps, frame));
  });
}

