// View of a body: one shape of a run at a time, coloured, whole or cut open, with the shape before surgery as an overlay.
import { csv, save, short, stored, unpack, withUnit } from "./data.js";
import { colourOf, onTheme } from "./theme.js";

const MAPS = { displacement: "viridis", shift: "viridis", filled_fraction: "cividis", collagen_fraction: "cividis", cells_fraction: "cividis" };
const PLAIN = [0.86, 0.7, 0.6];
const TURN = 10; // rotation per key press [degrees]

export const BEFORE = "before surgery";

// sort key of a shape in time; the labels come from cicatrix.pages.bodies
export function rank(shape) {
  return shape.label === "healed" ? 1e9 : shape.label === BEFORE ? -2 : shape.days;
}

export class BodyView {
  constructor(figure, letter) {
    const { vtk } = globalThis.cicatrixLibraries;
    Object.assign(this, { figure, vtk, scene: stored(letter, "body"), maps: stored(letter, "maps"), name: letter, arrays: new Map() });
    this.canvas = figure.querySelector(".canvas");
    this.window = vtk.GenericRenderWindow.newInstance({ background: colourOf("--stage") });
    this.window.setContainer(this.canvas);
    this.window.resize();
    this.renderer = this.window.getRenderer();
    this.camera = this.renderer.getActiveCamera();
    this.actor = this.#actor();
    this.ghost = this.#actor();
    this.ghost.getProperty().setOpacity(this.isSolid ? 0.3 : 1);
    if (!this.isSolid) this.#flat();
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
    onTheme(() => { this.renderer.setBackground(colourOf("--stage")); this.#tint(); this.draw(); });
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
    figure.querySelector('[data-save="png"]').addEventListener("click", () => this.#savePicture());
    figure.querySelector('[data-save="csv"]').addEventListener("click", () => this.#saveData());
  }

  get isSolid() { return this.scene.dimension === 3; }
  get shapes() { return this.scene.shapes; }

  draw() { this.window.getRenderWindow().render(); }

  // the shape in a position at a given time, or else the last one before it
  pick(position, label, at) {
    const own = this.shapes.filter((shape) => shape.position === position);
    const candidates = own.length ? own : this.shapes;
    const before = candidates.filter((shape) => rank(shape) <= at);
    return candidates.find((shape) => shape.label === label) ?? before.at(-1) ?? candidates[0];
  }

  async show({ position, label, at, colour, range, cut, ghost }) {
    const turn = (this.turn = (this.turn ?? 0) + 1);
    const shape = this.pick(position, label, at);
    const surfaceOf = ({ surfaces }) => (cut && surfaces.cut) || surfaces.whole;
    const surface = surfaceOf(shape);
    const [points, triangles] = [await this.#array(surface.points), await this.#array(surface.triangles)];
    const [isCell, packed] = colour in surface.inCells ? [true, surface.inCells[colour]] : [false, surface.atPoints[colour]];
    const values = packed && (await this.#array(packed));
    const old = this.shapes.find((other) => other.position === shape.position && other.label === BEFORE);
    const outline = old?.outline && (await this.#array(old.outline));
    const oldPoints = old && (await this.#array(surfaceOf(old).points));
    const oldTriangles = old && (await this.#array(surfaceOf(old).triangles));
    if (turn !== this.turn) return; // a newer request has replaced this one
    this.shown = { shape, points, triangles, values, colour, isCell };
    this.#fill(this.actor, points, { triangles, values, isCell, range, map: MAPS[colour] ?? "plasma" });
    this.ghost.setVisibility(Boolean(ghost && old));
    if (ghost && old) this.#fill(this.ghost, oldPoints, outline ? { lines: outline } : { triangles: oldTriangles });
    if (!this.placed) this.view(this.isSolid ? "front" : "flat");
    this.draw();
    this.#say(colour, range, label);
    this.figure.dataset.drawn = `${shape.position}, ${shape.label}, ${colour}`;
  }

  view(name) {
    const outward = this.scene.side === "left" ? 1 : -1;
    const [from, up] = {
      front: [[0, -1, 0], [0, 0, 1]],
      side: [[outward, 0, 0], [0, 0, 1]],
      below: [[0, -0.5, -1], [0, -1, 0.5]],
      flat: this.scene.isDownward ? [[0, 0, -1], [0, -1, 0]] : [[0, 0, 1], [0, 1, 0]],
    }[name];
    this.camera.setFocalPoint(0, 0, 0);
    this.camera.setPosition(...from);
    this.camera.setViewUp(...up);
    this.renderer.resetCamera();
    if (this.isSolid) this.camera.zoom(1.2);
    else this.#fit();
    this.renderer.resetCameraClippingRange();
    this.placed = true;
    this.draw();
  }

  // zoom a section so that it fills the canvas
  #fit() {
    const [x0, x1, y0, y1] = this.actor.getBounds();
    const aspect = this.canvas.clientWidth / this.canvas.clientHeight;
    this.camera.setParallelScale(0.53 * Math.max(y1 - y0, (x1 - x0) / aspect));
  }

  // copy the camera of another view
  follow(other) {
    this.camera.set({ position: other.camera.getPosition(), focalPoint: other.camera.getFocalPoint(), viewUp: other.camera.getViewUp(),
      parallelScale: other.camera.getParallelScale(), viewAngle: other.camera.getViewAngle() });
    this.renderer.resetCameraClippingRange();
    this.draw();
  }

  #actor() {
    const mapper = this.vtk.Mapper.newInstance();
    const actor = this.vtk.Actor.newInstance();
    actor.setMapper(mapper);
    actor.getProperty().setAmbient(0.25);
    actor.getProperty().setDiffuse(0.75);
    return actor; // added to the scene once it has data, because VTK reports an error for an actor without any
  }

  #flat() {
    const style = this.vtk.InteractorStyleManipulator.newInstance();
    style.addMouseManipulator(this.vtk.Pan.newInstance({ button: 1 }));
    style.addMouseManipulator(this.vtk.Zoom.newInstance({ scrollEnabled: true, dragEnabled: false }));
    this.window.getInteractor().setInteractorStyle(style);
    this.camera.setParallelProjection(true);
    this.actor.getProperty().setLighting(false);
  }

  #tint() {
    this.ghost.getProperty().setColor(...colourOf("--ink"));
    this.ghost.getProperty().setLineWidth(2);
  }

  #fill(actor, points, { triangles, lines, values, isCell, range, map }) {
    const data = this.vtk.PolyData.newInstance();
    data.getPoints().setData(points, 3);
    if (triangles) data.getPolys().setData(counted(triangles, 3));
    if (triangles && this.isSolid) {
      data.getPointData().setNormals(this.vtk.DataArray.newInstance({ name: "normals", values: normals(points, triangles), numberOfComponents: 3 }));
    }
    if (lines) data.getLines().setData(counted(lines, 2));
    const mapper = actor.getMapper();
    mapper.setScalarVisibility(Boolean(values));
    if (values) {
      const scalars = this.vtk.DataArray.newInstance({ name: "value", values, numberOfComponents: 1 });
      (isCell ? data.getCellData() : data.getPointData()).setScalars(scalars);
      mapper.setScalarMode(isCell ? 2 : 1);
      mapper.setInterpolateScalarsBeforeMapping(!isCell);
      mapper.setLookupTable(this.#table(map, range));
      mapper.setUseLookupTableScalarRange(true);
      this.#scale(map, range);
    } else if (actor === this.actor) {
      actor.getProperty().setColor(...PLAIN);
      this.#scale(null);
    }
    if (actor === this.ghost) this.#tint();
    mapper.setInputData(data);
    this.renderer.addActor(actor);
  }

  #table(map, [low, high]) {
    const table = this.vtk.ColorTransferFunction.newInstance();
    const stops = this.maps[map];
    stops.forEach((rgb, k) => table.addRGBPoint(low + ((high - low) * k) / (stops.length - 1), ...rgb));
    return table;
  }

  #scale(map, range) {
    const scale = this.figure.querySelector(".scale");
    scale.hidden = !map;
    if (!map) return;
    const stops = this.maps[map].map((rgb) => `rgb(${rgb.map((c) => Math.round(255 * c)).join(" ")})`);
    scale.querySelector(".bar").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    scale.querySelector(".low").textContent = short(range[0]);
    scale.querySelector(".high").textContent = short(range[1]);
  }

  #say(name, range, wanted) {
    const { shape, values } = this.shown;
    const colour = this.scene.colours.find((entry) => entry.name === name);
    this.figure.querySelector(".where").textContent = `${shape.label}, ${shape.position}`;
    if (colour) this.figure.querySelector(".high").textContent = `${short(range[1])}${values && greatest(values) > range[1] * 1.001 ? " or more" : ""}`;
    this.figure.querySelector(".unit").textContent = colour ? withUnit(colour.label, colour.unit) : "";
    const instead = shape.label === wanted ? "" : ` This run has no shape for ${wanted}; the view shows ${shape.label}.`;
    const most = colour && values ? ` ${colour.label}: ${short(least(values))} to ${short(greatest(values))} ${colour.unit === "1" ? "" : colour.unit}.` : "";
    this.figure.querySelector(".said").textContent = `${shape.label}, ${shape.position}.${most}${instead}`;
  }

  #resize() {
    this.window.resize();
    this.draw();
  }

  #key(event) {
    const turns = { ArrowLeft: ["azimuth", -TURN], ArrowRight: ["azimuth", TURN], ArrowUp: ["elevation", TURN], ArrowDown: ["elevation", -TURN] };
    const zooms = { "+": 1.1, "=": 1.1, "-": 1 / 1.1 };
    if (event.key in zooms) this.camera.zoom(zooms[event.key]);
    else if (event.key in turns && this.isSolid) this.camera[turns[event.key][0]](turns[event.key][1]);
    else return;
    event.preventDefault();
    this.camera.orthogonalizeViewUp();
    this.renderer.resetCameraClippingRange();
    this.draw();
  }

  async #array(packed) {
    if (!this.arrays.has(packed)) this.arrays.set(packed, unpack(packed));
    return this.arrays.get(packed);
  }

  async #savePicture() {
    const shot = this.window.getApiSpecificRenderWindow().captureNextImage("image/png");
    this.draw();
    save(`body-${this.name}.png`, await shot);
  }

  #saveData() {
    const { shape, points, triangles, values, colour, isCell } = this.shown;
    const rows = [];
    if (isCell) {
      for (let t = 0; t < triangles.length / 3; t++) rows.push([...[0, 1, 2].map((c) => mean(points, triangles, t, c)), values?.[t] ?? ""]);
    } else {
      for (let p = 0; p < points.length / 3; p++) rows.push([points[3 * p], points[3 * p + 1], points[3 * p + 2], values?.[p] ?? ""]);
    }
    save(`body-${this.name}-${shape.position}-${shape.label}.csv`.replaceAll(" ", "-"), csv(["x_mm", "y_mm", "z_mm", colour || "no_colour"], rows), "text/csv");
  }
}

const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const greatest = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
const mean = (points, triangles, t, c) => (points[3 * triangles[3 * t] + c] + points[3 * triangles[3 * t + 1] + c] + points[3 * triangles[3 * t + 2] + c]) / 3;

// cells in VTK's format: each cell preceded by its number of points
function counted(cells, n) {
  const out = new Uint32Array((cells.length / n) * (n + 1));
  for (let k = 0, at = 0; k < cells.length; k += n) {
    out[at++] = n;
    for (let j = 0; j < n; j++) out[at++] = cells[k + j];
  }
  return out;
}

// outward normals at the points: area-weighted means over the adjacent triangles
function normals(points, triangles) {
  const out = new Float32Array(points.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * triangles[t + k]);
    const [u, v] = [b, c].map((end) => [0, 1, 2].map((k) => points[end + k] - points[a + k]));
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) out[corner + k] += n[k];
  }
  for (let p = 0; p < out.length; p += 3) {
    const size = Math.hypot(out[p], out[p + 1], out[p + 2]) || 1;
    for (let k = 0; k < 3; k++) out[p + k] /= size;
  }
  return out;
}
