// Points and surfaces of submaps: fetched when they are asked for, a few at a time, the latest ones kept.
"use strict";

import { Box3, BufferAttribute, BufferGeometry, Vector3 } from "/vendor/three-0.187.0/three.module.js";
import { GLTFLoader } from "/vendor/three-0.187.0/GLTFLoader.js";
import { PLYLoader } from "/vendor/three-0.187.0/PLYLoader.js";
import { MeshoptDecoder } from "/vendor/meshoptimizer-1.3.0/meshopt_decoder_reference.js";
import { readFile } from "/api.js";

const AT_ONCE = 3;
const MOST_KEPT = 400;
const MOST_POINTS = 60_000;

const points = new PLYLoader();
points.setCustomPropertyNameMapping({ intensity: ["intensity"], ring: ["ring"] });
/** The columns of points that are drawn, and how many numbers each has. */
const COLUMNS = { intensity: 1, ring: 1, color: 3 };
const meshes = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
const kept = new Map();
const waiting = [];
let loading = 0;

/** The geometry of a submap in its own frame: `kind` is points or mesh. Raises Refused where it is not to be had. */
export function geometryOf(submap, kind) {
  const key = `${kind}:${submap}`;
  if (!kept.has(key)) {
    const made = new Promise((resolve, reject) => waiting.push({ submap, kind, resolve, reject }));
    made.catch(() => kept.delete(key));
    kept.set(key, made);
    if (kept.size > MOST_KEPT) drop(kept.keys().next().value);
    pump();
  }
  return kept.get(key);
}

/** Forget what nobody has begun to fetch: the map or the mode is another. */
export function forgetWaiting() {
  for (const { submap, kind, reject } of waiting.splice(0)) {
    kept.delete(`${kind}:${submap}`);
    reject(new Error("no longer asked for"));
  }
}

function drop(key) {
  kept.get(key).then((geometry) => geometry.dispose()).catch(() => {});
  kept.delete(key);
}

function pump() {
  while (loading < AT_ONCE && waiting.length) {
    const { submap, kind, resolve, reject } = waiting.shift();
    loading += 1;
    fetched(submap, kind).then(resolve, reject).finally(() => {
      loading -= 1;
      pump();
    });
  }
}

async function fetched(submap, kind) {
  const bytes = await readFile(`/v1/${submap}:download?format=${kind === "mesh" ? "glb" : "ply"}`);
  return kind === "mesh" ? surfaceOf(await meshes.parseAsync(bytes, "")) : thinned(points.parse(bytes));
}

/** The one mesh of a scene in metres with z up, as the submap has it; glTF has y up and whole steps. */
function surfaceOf(gltf) {
  gltf.scene.rotation.x = Math.PI / 2;
  gltf.scene.updateMatrixWorld(true);
  let made = new BufferGeometry();
  made.setAttribute("position", new BufferAttribute(new Float32Array(0), 3));
  gltf.scene.traverse((part) => {
    if (part.isMesh) made = inMetres(part.geometry, part.matrixWorld);
  });
  made.computeVertexNormals();
  made.computeBoundingSphere();
  made.userData.heights = heightsOf(made.getAttribute("position").array);
  return made;
}

function inMetres(geometry, matrix) {
  const steps = geometry.getAttribute("position");
  const metres = new Float32Array(3 * steps.count);
  const at = new Vector3();
  for (let row = 0; row < steps.count; row += 1) {
    at.fromBufferAttribute(steps, row).applyMatrix4(matrix).toArray(metres, 3 * row);
  }
  const made = new BufferGeometry();
  made.setAttribute("position", new BufferAttribute(metres, 3));
  made.setIndex(geometry.getIndex());
  return made;
}

/** Every n-th point, with the columns that points have, so that there are at most `MOST_POINTS`. */
function thinned(geometry) {
  const all = geometry.getAttribute("position");
  const step = Math.max(1, Math.ceil(all.count / MOST_POINTS));
  const made = new BufferGeometry();
  const points = everyNth(all, 3, step);
  made.setAttribute("position", new BufferAttribute(points, 3));
  made.computeBoundingSphere();
  made.userData = { heights: heightsOf(points), ranges: {} };
  for (const [name, size] of Object.entries(COLUMNS)) {
    const column = geometry.getAttribute(name);
    if (!Number.isFinite(column?.getX(0))) continue; // the loader makes up a column that a file has not
    const values = everyNth(column, size, step);
    made.setAttribute(name, new BufferAttribute(values, size));
    made.userData.ranges[name] = bulkOf(values.slice(), 0);
  }
  return made;
}

/** The numbers of every n-th point of an attribute, `size` of each. */
function everyNth(attribute, size, step) {
  const count = Math.ceil(attribute.count / step);
  const values = new Float32Array(size * count);
  for (let to = 0, from = 0; to < count; to += 1, from += step) {
    values[size * to] = attribute.getX(from);
    if (size === 3) values.set([attribute.getY(from), attribute.getZ(from)], size * to + 1);
  }
  return values;
}

const heightsOf = (points) => bulkOf(points.filter((_, index) => index % 3 === 2), 1);

/** The numbers between which nearly all of `values` lie, which are sorted; 0 and `high` for none. */
function bulkOf(values, high) {
  values.sort();
  return [values[Math.floor(0.02 * (values.length - 1))] ?? 0, values[Math.ceil(0.97 * (values.length - 1))] ?? high];
}

/** The extent of a geometry without its outermost points: [centre, radius in metres]. */
export function extentOf(geometry) {
  const positions = geometry.getAttribute("position");
  const axes = [[], [], []];
  const step = Math.max(1, Math.floor(positions.count / 4000));
  for (let at = 0; at < positions.count; at += step) {
    axes[0].push(positions.getX(at));
    axes[1].push(positions.getY(at));
    axes[2].push(positions.getZ(at));
  }
  const low = new Vector3();
  const high = new Vector3();
  axes.forEach((values, axis) => {
    values.sort((a, b) => a - b);
    low.setComponent(axis, values[Math.floor(0.04 * (values.length - 1))]);
    high.setComponent(axis, values[Math.ceil(0.96 * (values.length - 1))]);
  });
  const box = new Box3(low, high);
  return [box.getCenter(new Vector3()), Math.max(2, box.getSize(new Vector3()).length() / 2)];
}
