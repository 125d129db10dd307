// The dashboard: reads /v1 every few seconds and draws it. Text only ever enters the page as textContent.
"use strict";

const REFRESH_MS = 3000;
const COLOURS = { DESCRIBED: "#1c7ed6", QUEUED: "#adb5bd", FAILED: "#e03131", LOOP: "#f08c00" };
const byId = (id) => document.getElementById(id);

async function read(path) {
  const answer = await fetch(path, { headers: { accept: "application/json" } });
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}

async function readAll(path, field) {
  const items = [];
  let token = "";
  do {
    const separator = path.includes("?") ? "&" : "?";
    const page = await read(`${path}${separator}page_size=500&page_token=${encodeURIComponent(token)}`);
    items.push(...page[field]);
    token = page.next_page_token;
  } while (token);
  return items;
}

function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

function showStatus(status) {
  const rows = {
    version: status.version,
    models: status.model_version ?? "no worker yet",
    workers: status.workers.length,
    queued: status.queued_jobs,
    running: status.running_jobs,
    failed: status.failed_jobs,
    "submaps in the index": status.indexed_submaps,
  };
  byId("status").replaceChildren(
    ...Object.entries(rows).map(([term, value]) => {
      const row = document.createElement("div");
      row.append(element("dt", term), element("dd", String(value)));
      return row;
    }),
  );
}

function showMaps(maps) {
  const select = byId("map");
  const chosen = select.value;
  select.replaceChildren(
    ...maps.map((map) => {
      const id = map.name.slice("maps/".length);
      const option = element("option", map.display_name ? `${map.display_name} (${id})` : id);
      option.value = map.name;
      return option;
    }),
  );
  if (maps.some((map) => map.name === chosen)) select.value = chosen;
  return select.value;
}

function showList(id, items, empty) {
  const rows = items.map(([title, detail]) => {
    const row = element("li", title);
    row.append(element("small", detail));
    return row;
  });
  byId(id).replaceChildren(...(rows.length ? rows : [element("li", empty)]));
}

const shortName = (name) => name.split("/").filter((_, index) => index % 2 === 1).slice(1).join(" / ");

function showSessions(sessions) {
  showList(
    "sessions",
    sessions.map((session) => [
      shortName(session.name),
      `${session.state.toLowerCase()}, ${session.travelled_m.toFixed(0)} m, ${session.submap_count} submaps, ` +
        `scan ${session.committed_seq}`,
    ]),
    "none yet",
  );
}

function showLoops(loops) {
  showList(
    "loops",
    loops.slice(-100).reverse().map((loop) => [
      `${shortName(loop.query)} \u2192 ${shortName(loop.match)}`,
      `score ${loop.score.toFixed(2)}, similarity ${loop.similarity.toFixed(2)}`,
    ]),
    "none yet",
  );
}

function projection(points, width, height) {
  const xs = points.map((point) => point.x);
  const ys = points.map((point) => point.y);
  const extent = (values) => [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
  const [[x0, x1], [y0, y1]] = [extent(xs), extent(ys)];
  const margin = 30;
  const scale = Math.min((width - 2 * margin) / Math.max(x1 - x0, 1), (height - 2 * margin) / Math.max(y1 - y0, 1));
  return (point) => [
    width / 2 + (point.x - (x0 + x1) / 2) * scale,
    height / 2 - (point.y - (y0 + y1) / 2) * scale,
  ];
}

function line(context, points, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
}

function draw(tracks, loops) {
  const canvas = byId("trajectory");
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const submaps = tracks.flat();
  byId("message").textContent = submaps.length ? `${submaps.length} submaps, ${loops.length} loop closures` : "No submaps yet.";
  if (!submaps.length) return;
  const place = projection(submaps.map((submap) => submap.position_m), width, height);
  const where = new Map(submaps.map((submap) => [submap.name, place(submap.position_m)]));
  for (const track of tracks) line(context, track.map((submap) => where.get(submap.name)), "#868e96", 1);
  for (const loop of loops) {
    const ends = [where.get(loop.query), where.get(loop.match)];
    if (ends.every(Boolean)) line(context, ends, COLOURS.LOOP, 2);
  }
  for (const submap of submaps) {
    const [x, y] = where.get(submap.name);
    context.fillStyle = COLOURS[submap.state] ?? COLOURS.QUEUED;
    context.beginPath();
    context.arc(x, y, 3.5, 0, 2 * Math.PI);
    context.fill();
  }
}

async function refresh() {
  try {
    showStatus(await read("/v1/status"));
    const map = showMaps(await readAll("/v1/maps", "maps"));
    if (!map) {
      byId("message").textContent = "No maps yet.";
      return;
    }
    const sessions = await readAll(`/v1/${map}/sessions`, "sessions");
    const loops = await readAll(`/v1/${map}/loopClosures?state=ACCEPTED`, "loop_closures");
    const tracks = await Promise.all(sessions.map((session) => readAll(`/v1/${session.name}/submaps`, "submaps")));
    showSessions(sessions);
    showLoops(loops);
    draw(tracks, loops);
  } catch (error) {
    byId("message").textContent = `The service does not answer (${error.message}).`;
  }
}

async function run() {
  await refresh();
  window.setTimeout(run, REFRESH_MS);
}

byId("map").addEventListener("change", refresh);
run();
