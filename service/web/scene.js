// The map in 3D: sessions as coloured paths of submaps, loop closures between them, points or surfaces on demand.
"use strict";

import * as THREE from "/vendor/three-0.187.0/three.module.js";
import { OrbitControls } from "/vendor/three-0.187.0/OrbitControls.js";
import { Line2 } from "/vendor/three-0.187.0/Line2.js";
import { LineGeometry } from "/vendor/three-0.187.0/LineGeometry.js";
import { LineMaterial } from "/vendor/three-0.187.0/LineMaterial.js";
import { LineSegments2 } from "/vendor/three-0.187.0/LineSegments2.js";
import { LineSegmentsGeometry } from "/vendor/three-0.187.0/LineSegmentsGeometry.js";
import { forgetWaiting, geometryOf } from "/clouds.js";
import { RAMP } from "/colouring.js";
import { themed } from "/colours.js";
import { between, inverse, matrixOf, product } from "/frames.js";

const NEAR_PX = 14;
const NEAR_LOOP_PX = 7;
const MOST_SURFACES = 250;
const THROUGHOUT = new Set(["SCALE", "SLOPE", "HEADING"]);
const [UP, DOWN] = [new THREE.Vector3(0, 0, 1), new THREE.Vector3(0, 0, -1)];
const SHAPES = { DESCRIBED: 0, QUEUED: 1, FAILED: 2 };

const DOTS = {
  vertexShader: `
    attribute vec3 tint; attribute float shape; attribute float size;
    uniform float pixels;
    varying vec3 vTint; varying float vShape;
    #include <clipping_planes_pars_vertex>
    void main() {
      vTint = tint; vShape = shape;
      vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * mvPosition;
      gl_PointSize = size * pixels;
      #include <clipping_planes_vertex>
    }`,
  fragmentShader: `
    uniform vec3 paper;
    varying vec3 vTint; varying float vShape;
    #include <clipping_planes_pars_fragment>
    void main() {
      #include <clipping_planes_fragment>
      vec2 at = 2.0 * gl_PointCoord - 1.0;
      float r = length(at), soft = fwidth(r);
      float inside = 1.0 - smoothstep(0.98 - soft, 0.98, r);
      vec3 tint = mix(vTint, paper, smoothstep(0.70 - soft, 0.70, r));
      if (vShape > 0.5 && vShape < 1.5) tint = mix(paper, tint, smoothstep(0.42 - soft, 0.42, r));
      if (vShape > 1.5) {
        float cross = min(abs(at.x - at.y), abs(at.x + at.y));
        inside = 1.0 - smoothstep(0.30, 0.36, cross);
        tint = vTint;
      }
      if (inside < 0.02) discard;
      gl_FragColor = vec4(tint, inside);
      #include <colorspace_fragment>
    }`,
  clipping: true,
};

/** The loop closures of one state as lines: how they look says what they are, without their colour, too. */
const LINES = {
  accepted: { colour: "--accepted", linewidth: 1.5, opacity: 0.8 },
  ambiguous: { colour: "--ambiguous", linewidth: 1.8, opacity: 0.9, dashed: true },
  rejected: { colour: "--rejected", linewidth: 1, opacity: 0.45, dashed: true },
};

const OF_ANCHORS = { IN_MAP: "--good", SET_ASIDE: "--failed", NOT_ALIGNED: "--ambiguous", STATE_UNSPECIFIED: "--faint" };
const OF_CHANGES = { VANISHED: "--failed", APPEARED: "--good", MOVED: "--mark", BACK: "--ambiguous" };

/** The twelve edges of the box of a change, and the way that a thing has moved: x, y, z of both ends of each. */
function edgesOf({ centre_m: c, extent_m: e, moved_from_m: from }) {
  const corner = (bits) => [0, 1, 2].map((axis) => [c.x, c.y, c.z][axis] + (bits & (1 << axis) ? 0.5 : -0.5) * [e.x, e.y, e.z][axis]);
  const edges = [];
  for (let bits = 0; bits < 8; bits += 1) {
    for (const axis of [1, 2, 4]) if (!(bits & axis)) edges.push(...corner(bits), ...corner(bits | axis));
  }
  return from ? [...edges, from.x, from.y, from.z, c.x, c.y, c.z] : edges;
}

/** The drawing on a canvas. Give it a map with `show`; ask it with `nearest` what is under the pointer. */
export class MapView {
  constructor(canvas, onCamera = () => {}) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
    this.canvas = canvas;
    this.onCamera = onCamera;
    this.onSurface = () => {};
    this.covered = () => ({ top: 0, bottom: 0 });
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.scene = new THREE.Scene();
    this.ground = new THREE.Scene(); // what lies underneath, and is cut by no slice
    this.slice = { low: -Infinity, high: Infinity };
    this.planes = [];
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.1, 50_000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: false, screenSpacePanning: false, maxPolarAngle: Math.PI * 0.495, zoomToCursor: true });
    this.controls.mouseButtons = { LEFT: THREE.MOUSE.PAN, MIDDLE: THREE.MOUSE.DOLLY, RIGHT: THREE.MOUSE.ROTATE };
    this.controls.addEventListener("change", () => this.draw());
    this.paths = new THREE.Group();
    this.loops = new THREE.Group();
    this.surfaces = new THREE.Group();
    this.marks = new THREE.Group();
    this.rulers = new THREE.Group();
    this.changes = new THREE.Group();
    this.things = new THREE.Group();
    this.anchors = new THREE.Group();
    this.plans = new THREE.Group();
    this.dots = null;
    this.faultMarks = [];
    this.grid = null;
    this.ground.add(this.plans);
    this.scene.add(this.surfaces, this.paths, this.loops, this.changes, this.things, this.anchors, this.marks, this.rulers);
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#66727e", 1.5));
    this.sun = new THREE.DirectionalLight("#ffffff", 1.5);
    this.sun.position.set(0.9, -1.2, 0.9);
    this.scene.add(this.sun);
    this.map = { tracks: [], loops: [], faults: [] };
    this.places = new Map();
    this.surface = "none";
    this.colouring = null;
    this.asked = 0;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  /**
   * `tracks` is [{ name, colour, submaps, T_drawing_odom }] of the visible sessions; `loops` [{ loop, state }]; `lift` in
   * metres a submap; `frame` is that of the map in which submaps are drawn, null for none, and `corrected` 0..1 how far
   * they are there, on the way from where odometry has them. `faults` are those of odometry. `colouringOf` makes the
   * colouring (colouring.js) of where submaps are, null for the colours of the sessions.
   */
  show({ tracks, loops, lift, frame = null, corrected = 1, faults = [], colouringOf = () => null }) {
    const first = !this.places.size;
    this.map = { tracks, loops, faults };
    this.place(lift, frame, corrected);
    const before = this.colouring;
    this.colouring = colouringOf();
    if (before !== this.colouring) clear(this.surfaces, false);
    this.drawPaths();
    this.drawLoops();
    this.drawGrid();
    this.showSurface(this.surface);
    if (first && this.places.size) this.fit();
    this.draw();
  }

  /** Where each submap is drawn: its matrix, with the lift. */
  place(lift, frame, corrected) {
    this.places.clear();
    let floor = 0;
    for (const track of this.map.tracks) {
      track.submaps.forEach((submap, index) => {
        const driven = product(track.T_drawing_odom, matrixOf(submap.t_odom_submap));
        const known = frame !== null && submap.t_map_submap && submap.frame === frame;
        const pose = known ? between(driven, matrixOf(submap.t_map_submap), corrected) : driven;
        const raised = new THREE.Matrix4().makeTranslation(0, 0, floor + lift * index).multiply(pose);
        const at = new THREE.Vector3().setFromMatrixPosition(raised);
        this.places.set(submap.name, { submap, track, matrix: raised, at, height: pose.elements[14] });
      });
      floor += lift * (track.submaps.length + 4);
    }
  }

  /** The colour of a submap that is drawn. */
  tintOf({ submap, track }) {
    return this.colouring ? this.colouring.colourOf(submap.name) : track.colour;
  }

  /** How high a submap lies, without the lift, metres. */
  heightOf(name) {
    return this.places.get(name)?.height;
  }

  drawPaths() {
    clear(this.paths);
    const points = [...this.places.values()];
    for (const track of this.map.tracks) {
      const line = track.submaps.flatMap((submap) => this.places.get(submap.name).at.toArray());
      if (line.length >= 6) this.paths.add(this.line(new LineGeometry().setPositions(line), this.colouring ? themed("--faint") : track.colour, this.colouring ? 1.2 : 2.6));
    }
    this.drawFaults();
    const small = points.length > 600 ? 8 : points.length > 200 ? 10 : 12;
    const geometry = new THREE.BufferGeometry();
    const tints = points.map((place) => new THREE.Color(place.submap.state === "FAILED" ? themed("--failed") : this.tintOf(place)));
    geometry.setAttribute("position", floats(points.flatMap(({ at }) => at.toArray()), 3));
    geometry.setAttribute("tint", floats(tints.flatMap((tint) => tint.toArray()), 3));
    geometry.setAttribute("shape", floats(points.map(({ submap }) => SHAPES[submap.state] ?? 0), 1));
    geometry.setAttribute("size", floats(points.map(({ submap }) => (submap.state === "FAILED" ? small + 4 : small)), 1));
    const uniforms = { pixels: { value: this.renderer.getPixelRatio() }, paper: { value: new THREE.Color(themed("--stage")) } };
    const material = new THREE.ShaderMaterial({ ...DOTS, uniforms, transparent: true, depthWrite: false, depthTest: false });
    this.dots = new THREE.Points(geometry, material);
    this.dots.renderOrder = 3;
    this.dots.frustumCulled = false;
    this.paths.add(this.dots);
  }

  /** The way on which odometry went wrong, or all of it; `faultMarks` are the middles. */
  drawFaults() {
    this.faultMarks = [];
    for (const fault of this.map.faults ?? []) {
      const track = this.map.tracks.find(({ name }) => name === fault.session);
      const [first, last] = [fault.first_submap, fault.last_submap].map((name) => track?.submaps.findIndex((submap) => submap.name === name) ?? -1);
      if (first < 0 || last <= first) continue;
      const way = track.submaps.slice(first, last + 1).map((submap) => this.places.get(submap.name).at);
      const throughout = THROUGHOUT.has(fault.kind);
      const line = this.line(new LineGeometry().setPositions(way.flatMap((at) => at.toArray())), themed("--failed"), throughout ? 1.2 : 7);
      if (!throughout) line.renderOrder = 2.5;
      this.paths.add(line);
      const at = way.length > 2 ? way[way.length >> 1].clone() : way[0].clone().add(way[1]).multiplyScalar(0.5);
      this.faultMarks.push({ fault, at });
    }
  }

  drawLoops() {
    clear(this.loops);
    this.ends = [];
    const byState = Map.groupBy(this.map.loops, ({ state }) => state);
    for (const [state, style] of Object.entries(LINES)) {
      const positions = [];
      for (const { loop } of byState.get(state) ?? []) {
        const [query, match] = [this.places.get(loop.query), this.places.get(loop.match)];
        if (!query || !match) continue;
        positions.push(...query.at.toArray(), ...match.at.toArray());
        this.ends.push({ loop, from: query.at, to: match.at });
      }
      if (!positions.length) continue;
      const material = this.material(themed(style.colour), style.linewidth);
      // Many of them are a texture: what the sessions' colours say must show through it.
      const many = Math.min(1, Math.max(0.22, 60 / (positions.length / 6)));
      Object.assign(material, { transparent: true, opacity: style.opacity * many, dashed: Boolean(style.dashed), dashSize: 1.2, gapSize: 0.9 });
      const lines = new LineSegments2(new LineSegmentsGeometry().setPositions(positions), material);
      if (style.dashed) lines.computeLineDistances();
      lines.renderOrder = 1;
      this.loops.add(lines);
    }
    this.drawnLoops = this.ends.length;
  }

  line(geometry, colour, width) {
    const made = new Line2(geometry, this.material(colour, width));
    made.material.depthTest = false;
    made.renderOrder = 2;
    return made;
  }

  material(colour, linewidth) {
    const material = new LineMaterial({ color: new THREE.Color(colour), linewidth });
    material.resolution.set(this.canvas.clientWidth, this.canvas.clientHeight);
    return material;
  }

  /** Ground lines at round steps below everything that is drawn. */
  drawGrid() {
    if (this.grid) {
      this.ground.remove(this.grid);
      this.grid.geometry.dispose();
    }
    this.grid = null;
    const box = this.extent();
    if (box.isEmpty()) return;
    const size = box.getSize(new THREE.Vector3());
    const span = Math.max(size.x, size.y, 20) * 3;
    const step = roundMetres(span / 45);
    const count = 2 * Math.ceil(span / step / 2);
    this.grid = new THREE.GridHelper(count * step, count, themed("--grid-strong"), themed("--grid"));
    this.grid.rotation.x = Math.PI / 2;
    const centre = box.getCenter(new THREE.Vector3());
    this.grid.position.set(Math.round(centre.x / step) * step, Math.round(centre.y / step) * step, box.min.z - 0.02 * span - 1);
    this.grid.renderOrder = -1;
    this.grid.material.depthWrite = false;
    this.ground.add(this.grid);
  }

  /** Draw between two heights alone, metres, and let nothing else be picked: of all that does not lie underneath. */
  cut(low, high) {
    this.slice = { low, high };
    this.planes = [Number.isFinite(low) && new THREE.Plane(UP, -low), Number.isFinite(high) && new THREE.Plane(DOWN, high)].filter(Boolean);
    this.showStoreys();
    this.draw();
  }

  /** Whether a point of the drawing (Vector3) is in the slice that is shown. */
  isShown({ z }) {
    return z >= this.slice.low && z <= this.slice.high;
  }

  /** A plan that lies above the slice hides nothing of it. */
  showStoreys() {
    for (const sheet of this.plans.children) sheet.visible = sheet.geometry.getAttribute("position").getZ(0) <= this.slice.high;
  }

  /** The heights between which nearly all lies that is drawn, metres: [low, high]; null for nothing. */
  heights() {
    const found = [...this.places.values()].map(({ at }) => at.z);
    for (const { geometry, matrix } of this.surfaces.children) found.push(...geometry.userData.heights.map((height) => height + matrix.elements[14]));
    return found.length ? [Math.min(...found), Math.max(...found)] : null;
  }

  extent() {
    const box = new THREE.Box3();
    for (const { at } of this.places.values()) box.expandByPoint(at);
    return box;
  }

  /** Rings of so many pixels at points. */
  rings(at, pixels, colour = "--mark") {
    const uniforms = { pixels: { value: this.renderer.getPixelRatio() }, paper: { value: new THREE.Color(themed("--stage")) } };
    const geometry = new THREE.BufferGeometry();
    const tint = new THREE.Color(themed(colour));
    geometry.setAttribute("position", floats(at.flatMap((point) => point.toArray()), 3));
    geometry.setAttribute("tint", floats(at.flatMap(() => tint.toArray()), 3));
    geometry.setAttribute("shape", floats(at.map(() => 1), 1));
    geometry.setAttribute("size", floats(at.map(() => pixels), 1));
    const rings = new THREE.Points(geometry, new THREE.ShaderMaterial({ ...DOTS, fragmentShader: RING, uniforms, transparent: true, depthTest: false }));
    rings.renderOrder = 5;
    rings.frustumCulled = false;
    return rings;
  }

  /** Mark what is selected: the names of submaps, and a loop closure between two of them. */
  mark(names, loop = null) {
    clear(this.marks);
    const at = names.map((name) => this.places.get(name)?.at).filter(Boolean);
    if (at.length) this.marks.add(this.rings(at, 24));
    if (loop && at.length === 2) {
      const line = this.line(new LineGeometry().setPositions(at.flatMap((point) => point.toArray())), themed("--mark"), 4);
      line.renderOrder = 4;
      this.marks.add(line);
    }
    this.draw();
  }

  /** Show points or surfaces of the visible submaps, those nearest to the centre of the view first. */
  showSurface(kind) {
    const asked = (this.asked += 1);
    if (kind !== this.surface) {
      clear(this.surfaces, false);
      forgetWaiting();
    }
    this.surface = kind;
    const wanted = kind === "none" ? [] : this.nearestTo(this.controls.target).slice(0, MOST_SURFACES);
    const names = new Set(wanted.map(({ submap }) => submap.name));
    for (const shown of [...this.surfaces.children]) if (!names.has(shown.name)) this.surfaces.remove(shown);
    const there = new Map(this.surfaces.children.map((shown) => [shown.name, shown]));
    for (const place of wanted) {
      const shown = there.get(place.submap.name);
      if (shown) shown.matrix.copy(place.matrix);
      else if (kind === "points" || place.submap.state === "DESCRIBED") this.addSurface(place, kind, asked);
    }
    return wanted.length;
  }

  async addSurface(place, kind, asked) {
    const geometry = await geometryOf(place.submap.name, kind).catch(() => null);
    const now = this.places.get(place.submap.name);
    if (!geometry || asked > this.asked || this.surface !== kind || !now) return;
    if (this.surfaces.children.some((shown) => shown.name === place.submap.name)) return;
    const tint = this.tintOf(now);
    const shown = kind === "mesh" ? new THREE.Mesh(geometry, surfaceMaterial(tint)) : new THREE.Points(geometry, this.pointsOf(now, tint, geometry));
    shown.name = place.submap.name;
    shown.matrixAutoUpdate = false;
    shown.matrix.copy(now.matrix);
    this.surfaces.add(shown);
    this.onSurface();
    this.draw();
  }

  /** The material of a submap's points; by height or a column they have the whole ramp, or their colour, each for itself. */
  pointsOf(place, tint, geometry) {
    const size = 1.4 * this.renderer.getPixelRatio();
    const { heights, ranges } = geometry.userData;
    const attribute = this.colouring?.attribute;
    if (attribute === "color" && ranges.color) return new THREE.ShaderMaterial({ ...CLOUD, vertexShader: OWN_COLOURS, uniforms: { size: { value: size } } });
    if (ranges[attribute]) return rampMaterial(size, attribute, ranges[attribute], 1e-6);
    if (!this.colouring?.byHeight) return pointsMaterial(tint, size, heights);
    const { elements: e } = place.matrix;
    return rampMaterial(size, "at.z", heights.map((height) => height + e[14]), 0.5);
  }

  /** The ray through a point of the canvas. */
  casterThrough(x, y) {
    const caster = new THREE.Raycaster();
    caster.params.Points.threshold = this.metresOf(5);
    caster.setFromCamera(new THREE.Vector2((2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight), this.camera);
    for (const shown of this.surfaces.children) shown.updateMatrixWorld();
    return caster;
  }

  /** Where a ray first meets points or a surface in the slice that is shown. */
  firstShown(caster) {
    return caster.intersectObjects(this.surfaces.children, false).find(({ point }) => this.isShown(point));
  }

  /** What is under a point of the canvas: of the points or the surface, else a submap, else the ground; null for nothing. */
  pick(x, y) {
    const caster = this.casterThrough(x, y);
    const hit = this.firstShown(caster);
    if (hit) return hit.point.clone();
    const near = this.nearest(x, y)?.submap;
    if (near) return this.places.get(near.name).at.clone();
    const ground = new THREE.Plane(new THREE.Vector3(0, 0, 1), -(this.extent().min.z || 0));
    return caster.ray.intersectPlane(ground, new THREE.Vector3());
  }

  /** Draw a ruler through points, or the points alone, or take it away. */
  measure(points, joined = true) {
    clear(this.rulers);
    if (points.length) this.rulers.add(this.rings(points, 14));
    if (joined && points.length === 2) {
      const line = this.line(new LineGeometry().setPositions(points.flatMap((at) => at.toArray())), themed("--mark"), 3);
      line.renderOrder = 6;
      this.rulers.add(line);
    }
    this.draw();
  }

  /** Draw how submaps moved: `moves` is [{ name, from, to }] in the frame of the map. */
  showChanges(moves) {
    clear(this.changes);
    const drawn = moves.filter(({ name }) => this.places.has(name));
    if (drawn.length) {
      const positions = drawn.flatMap(({ from, to }) => [from.x, from.y, from.z, to.x, to.y, to.z]);
      const material = this.material(themed("--mark"), 3);
      material.depthTest = false;
      const lines = new LineSegments2(new LineSegmentsGeometry().setPositions(positions), material);
      lines.renderOrder = 4;
      this.changes.add(lines, this.rings(drawn.map(({ from }) => new THREE.Vector3(from.x, from.y, from.z)), 9));
    }
    this.draw();
  }

  /** Draw things that changed as boxes: [{ kind, centre_m, extent_m, moved_from_m }] in the frame of the map. */
  showThings(things) {
    clear(this.things);
    for (const [kind, colour] of Object.entries(OF_CHANGES)) {
      const edges = things.filter((one) => one.kind === kind).flatMap(edgesOf);
      if (!edges.length) continue;
      const lines = new LineSegments2(new LineSegmentsGeometry().setPositions(edges), this.material(themed(colour), 2));
      lines.renderOrder = 4;
      this.things.add(lines);
    }
    this.draw();
  }

  /** Draw anchors: [{ state, at, to }], where the map has the point of each, and where the world outside says it is. */
  showAnchors(anchors) {
    clear(this.anchors);
    for (const [state, colour] of Object.entries(OF_ANCHORS)) {
      const own = anchors.filter((one) => one.state === state);
      if (!own.length) continue;
      const material = this.material(themed(colour), 2);
      material.depthTest = false;
      const lines = new LineSegments2(new LineSegmentsGeometry().setPositions(own.flatMap(({ at, to }) => [...at.toArray(), ...to.toArray()])), material);
      lines.renderOrder = 4;
      this.anchors.add(lines, this.rings(own.map(({ to }) => to), 11, colour));
    }
    this.draw();
  }

  /** Draw plans underneath: [{ name, image, opacity, corners, height }], corners (4) as [x, y] from the upper left one clockwise. */
  showPlans(plans) {
    const there = new Map(this.plans.children.map((sheet) => [sheet.name, sheet]));
    const kept = plans.map((plan) => {
      const known = there.get(plan.name);
      const sheet = known?.userData.image === plan.image ? known : sheetOf(plan);
      const positions = sheet.geometry.getAttribute("position");
      plan.corners.forEach(([x, y], corner) => positions.setXYZ(corner, x, y, plan.height));
      positions.needsUpdate = true;
      sheet.material.opacity = plan.opacity;
      return sheet;
    });
    for (const sheet of [...this.plans.children].filter((one) => !kept.includes(one))) {
      this.plans.remove(sheet);
      for (const held of [sheet.material.map, sheet.material, sheet.geometry]) held.dispose();
    }
    for (const sheet of kept) this.plans.add(sheet);
    this.showStoreys();
    this.draw();
  }

  /** What is under a point of the canvas: of the points or the surface, else the ground at a height; null for nothing. */
  pickGround(x, y, height) {
    const caster = this.casterThrough(x, y);
    const hit = this.firstShown(caster);
    return hit?.point.clone() ?? caster.ray.intersectPlane(new THREE.Plane(new THREE.Vector3(0, 0, 1), -height), new THREE.Vector3());
  }

  /** T_target_source of two submaps as they are drawn; null where one is not. */
  relative(target, source) {
    const [at, from] = [target, source].map((name) => this.places.get(name)?.matrix);
    return at && from ? product(inverse(at), from) : null;
  }

  nearestTo(point) {
    return [...this.places.values()].sort((a, b) => a.at.distanceToSquared(point) - b.at.distanceToSquared(point));
  }

  /** Where a submap is on the canvas, in CSS pixels, or null. */
  whereIs(name) {
    const place = this.places.get(name);
    return place ? this.project(place.at) : null;
  }

  project(at) {
    const seen = at.clone().project(this.camera);
    return { x: ((seen.x + 1) / 2) * this.canvas.clientWidth, y: ((1 - seen.y) / 2) * this.canvas.clientHeight, hidden: seen.z > 1 || !this.isShown(at) };
  }

  /** The submap, else the loop closure, within reach of a point of the canvas: { submap } or { loop } or null. */
  nearest(x, y) {
    let found = null;
    let reach = NEAR_PX;
    for (const place of this.places.values()) {
      const at = this.project(place.at);
      const distance = at.hidden ? Infinity : Math.hypot(at.x - x, at.y - y);
      if (distance < reach) [found, reach] = [{ submap: place.submap, track: place.track }, distance];
    }
    if (found) return found;
    reach = NEAR_LOOP_PX;
    for (const { loop, from, to } of this.ends ?? []) {
      const distance = distanceToSegment(x, y, this.project(from), this.project(to));
      if (distance < reach) [found, reach] = [{ loop }, distance];
    }
    return found;
  }

  /** Look at everything; `view` top or tilted keeps to that direction, fit to the one there is. */
  fit(view = "tilted", names = null) {
    const points = this.chosen(names);
    const box = new THREE.Box3().setFromPoints(points);
    if (box.isEmpty()) return;
    const centre = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    const back = new THREE.Vector3().subVectors(this.camera.position, this.controls.target).normalize();
    if (view === "top") back.set(0, -0.001, 1);
    if (view === "tilted" || back.lengthSq() < 0.5) back.set(-0.25, -0.9, 0.75).normalize();
    const wide = Math.max(size.length(), 12);
    this.camera.near = wide / 2000;
    this.camera.far = wide * 60;
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(back, this.distanceTo(points, centre, back, wide));
    this.intoTheFree(back);
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.draw();
  }

  /** Where the submaps of these names are drawn, or all that are in the slice, or all. */
  chosen(names) {
    const at = [...this.places].filter(([name]) => !names || names.includes(name)).map(([, place]) => place.at);
    const shown = at.filter((one) => this.isShown(one));
    return shown.length ? shown : at;
  }

  /** Move the view by half of what tools cover more below than above: the middle lies between them then. */
  intoTheFree(back) {
    const { top, bottom } = this.covered();
    const right = new THREE.Vector3().crossVectors(this.camera.up, back).normalize();
    const down = new THREE.Vector3().crossVectors(right, back).multiplyScalar(this.metresOf((bottom - top) / 2));
    this.controls.target.add(down);
    this.camera.position.add(down);
  }

  /** How far back the camera stands so that all points are within the part of the view that no tools cover. */
  distanceTo(points, centre, back, wide) {
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const right = new THREE.Vector3().crossVectors(this.camera.up, back).normalize();
    const up = new THREE.Vector3().crossVectors(back, right);
    const offset = new THREE.Vector3();
    const { top, bottom } = this.covered();
    const high = this.canvas.clientHeight;
    const free = Math.max(0.4, (high - top - bottom) / (high || 1));
    return points.reduce((most, point) => {
      offset.subVectors(point, centre);
      const across = Math.max(Math.abs(offset.dot(right)) / this.camera.aspect, Math.abs(offset.dot(up)) / free);
      return Math.max(most, (across * 1.14) / half + offset.dot(back));
    }, 0.8 * wide / (points.length > 2 ? 4 : 1));
  }

  /** How many metres a number of CSS pixels are in the centre of the view. */
  metresOf(pixels) {
    const distance = this.camera.position.distanceTo(this.controls.target);
    return (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360) * pixels) / this.canvas.clientHeight;
  }

  retint() {
    this.renderer.setClearColor(themed("--stage"));
    this.drawPaths();
    this.drawLoops();
    this.drawGrid();
    this.draw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    this.renderer.setClearColor(themed("--stage"));
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    for (const group of [this.paths, this.loops, this.marks, this.rulers, this.changes, this.things, this.anchors]) {
      for (const { material } of group.children) material.resolution?.set(width, height);
    }
    this.paint();
  }

  /** Draw with the next frame. */
  draw() {
    if (this.due) return;
    this.due = requestAnimationFrame(() => this.paint());
  }

  paint() {
    cancelAnimationFrame(this.due);
    this.due = 0;
    const { renderer } = this;
    Object.assign(renderer, { autoClear: true, clippingPlanes: [] });
    renderer.render(this.ground, this.camera);
    Object.assign(renderer, { autoClear: false, clippingPlanes: this.planes });
    renderer.render(this.scene, this.camera);
    this.onCamera(this);
  }
}

/** A picture that lies flat: it is drawn before everything else, and hides nothing. */
function sheetOf({ name, image }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", floats(new Array(12).fill(0), 3));
  geometry.setAttribute("uv", floats([0, 0, 1, 0, 1, 1, 0, 1], 2));
  geometry.setIndex([0, 2, 1, 0, 3, 2]);
  const map = Object.assign(new THREE.Texture(image), { flipY: false, colorSpace: THREE.SRGBColorSpace, anisotropy: 8, needsUpdate: true });
  // Not `transparent`: that would be drawn after the points. Blended all the same.
  const blended = { blending: THREE.CustomBlending, blendSrc: THREE.SrcAlphaFactor, blendDst: THREE.OneMinusSrcAlphaFactor };
  const material = new THREE.MeshBasicMaterial({ map, side: THREE.DoubleSide, depthTest: false, depthWrite: false, ...blended });
  const sheet = new THREE.Mesh(geometry, material);
  Object.assign(sheet, { name, renderOrder: -0.5, frustumCulled: false });
  sheet.userData.image = image;
  return sheet;
}

const RING = `
  varying vec3 vTint; varying float vShape;
  #include <clipping_planes_pars_fragment>
  void main() {
    #include <clipping_planes_fragment>
    float r = length(2.0 * gl_PointCoord - 1.0), soft = fwidth(r);
    float ring = smoothstep(0.74 - soft, 0.74, r) * (1.0 - smoothstep(0.98 - soft, 0.98, r));
    if (ring < 0.02) discard;
    gl_FragColor = vec4(vTint, ring);
    #include <colorspace_fragment>
  }`;

/** Points of one colour, darker below and lighter above, so that a cloud is not a flat stain. */
export function pointsMaterial(colour, size, [low, high]) {
  const tint = new THREE.Color(colour);
  const uniforms = {
    size: { value: size },
    low: { value: low },
    high: { value: Math.max(high, low + 0.5) },
    below: { value: tint.clone().multiplyScalar(0.42) },
    above: { value: tint.clone().lerp(new THREE.Color("#ffffff"), 0.35) },
  };
  return new THREE.ShaderMaterial({ ...CLOUD, uniforms });
}

/** Points by `value`, their height in the drawing or an attribute, from `low` to `high` over the whole ramp. */
function rampMaterial(size, value, [low, high], least) {
  const uniforms = { size: { value: size }, low: { value: low }, high: { value: Math.max(high, low + least) }, stops: { value: RAMP.map((stop) => new THREE.Color(stop)) } };
  return new THREE.ShaderMaterial({ ...CLOUD, vertexShader: overRamp(value), uniforms });
}

const overRamp = (value) => `
  ${value === "at.z" ? "" : `attribute float ${value};`}
  uniform float size, low, high; uniform vec3 stops[5];
  varying vec3 vTint;
  #include <clipping_planes_pars_vertex>
  void main() {
    vec4 at = modelMatrix * vec4(position, 1.0);
    float share = clamp((${value} - low) / (high - low), 0.0, 1.0) * 4.0;
    vTint = stops[0];
    for (int stop = 0; stop < 4; stop++) vTint = mix(vTint, stops[stop + 1], clamp(share - float(stop), 0.0, 1.0));
    vec4 mvPosition = viewMatrix * at;
    gl_Position = projectionMatrix * mvPosition;
    gl_PointSize = size;
    #include <clipping_planes_vertex>
  }`;

const OWN_COLOURS = `
  attribute vec3 color;
  uniform float size;
  varying vec3 vTint;
  #include <clipping_planes_pars_vertex>
  void main() {
    vTint = color;
    vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * mvPosition;
    gl_PointSize = size;
    #include <clipping_planes_vertex>
  }`;

const CLOUD = {
  vertexShader: `
    uniform float size, low, high; uniform vec3 below, above;
    varying vec3 vTint;
    #include <clipping_planes_pars_vertex>
    void main() {
      vTint = mix(below, above, smoothstep(low, high, position.z));
      vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * mvPosition;
      gl_PointSize = size;
      #include <clipping_planes_vertex>
    }`,
  fragmentShader: `
    varying vec3 vTint;
    #include <clipping_planes_pars_fragment>
    void main() {
      #include <clipping_planes_fragment>
      gl_FragColor = vec4(vTint, 1.0);
      #include <colorspace_fragment>
    }`,
  clipping: true,
};

export const surfaceMaterial = (colour) => new THREE.MeshStandardMaterial({ color: colour, roughness: 0.85, metalness: 0, side: THREE.DoubleSide });

const floats = (values, size) => new THREE.BufferAttribute(new Float32Array(values), size);

/** Take everything out of a group; geometries that others use, too, stay. */
function clear(group, own = true) {
  for (const child of [...group.children]) {
    group.remove(child);
    child.material.dispose();
    if (own) child.geometry.dispose();
  }
}

function distanceToSegment(x, y, from, to) {
  if (from.hidden || to.hidden) return Infinity;
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const length = dx * dx + dy * dy;
  const along = length ? Math.max(0, Math.min(1, ((x - from.x) * dx + (y - from.y) * dy) / length)) : 0;
  return Math.hypot(from.x + along * dx - x, from.y + along * dy - y);
}

/** 1, 2 or 5 times a power of ten, at least `atLeast`. */
export function roundMetres(atLeast) {
  const power = 10 ** Math.floor(Math.log10(atLeast));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= atLeast * 0.999);
}
