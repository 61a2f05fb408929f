(() => {
  // src/data.js
  var store = /* @__PURE__ */ new Map();
  globalThis.cicatrixPut = (letter, name, content) => store.set(`${letter}.${name}`, content);
  var stored = (letter, name) => store.get(`${letter}.${name}`);
  var KINDS = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };
  function bytesOf(base64) {
    return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  }
  async function unpack(array) {
    const stream = new Blob([bytesOf(array.gzip)]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new KINDS[array.type](await new Response(stream).arrayBuffer());
  }
  function save(name, content, type) {
    const link2 = document.createElement("a");
    link2.href = content.startsWith?.("data:") ? content : URL.createObjectURL(new Blob([content], { type }));
    link2.download = name;
    link2.click();
    if (link2.href.startsWith("blob:")) setTimeout(() => URL.revokeObjectURL(link2.href), 1e4);
  }
  function csv(head, rows) {
    const cell = (value) => /[",\n]/.test(String(value)) ? `"${String(value).replaceAll('"', '""')}"` : String(value);
    return [head, ...rows].map((row) => row.map(cell).join(",")).join("\n") + "\n";
  }
  function short(value) {
    if (!Number.isFinite(value)) return "none";
    return Number(value.toPrecision(3)).toString().replace("-", "\u2212");
  }
  var withUnit = (label, unit) => unit && unit !== "1" ? `${label} [${unit}]` : label;

  // src/theme.js
  var listeners = [];
  var onTheme = (listener) => listeners.push(listener);
  function isDark() {
    const chosen = document.documentElement.dataset.theme;
    return chosen === "auto" ? matchMedia("(prefers-color-scheme: dark)").matches : chosen === "dark";
  }
  function startTheme() {
    const button = document.getElementById("theme");
    const told = () => {
      button.textContent = isDark() ? "Light" : "Dark";
      button.setAttribute("aria-pressed", String(isDark()));
      for (const listener of listeners) listener();
    };
    button.addEventListener("click", () => {
      document.documentElement.dataset.theme = isDark() ? "light" : "dark";
      told();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", told);
    told();
  }
  function colourOf(name) {
    const probe = document.createElement("span");
    probe.style.color = `var(${name})`;
    document.body.append(probe);
    const found = getComputedStyle(probe).color.match(/[\d.]+/g).slice(0, 3).map((c) => Number(c) / 255);
    probe.remove();
    return found;
  }

  // src/body.js
  var MAPS = { displacement: "viridis", shift: "viridis", filled_fraction: "cividis", collagen_fraction: "cividis", cells_fraction: "cividis" };
  var PLAIN = [0.86, 0.7, 0.6];
  var TURN = 10;
  var BEFORE = "before surgery";
  function rank(shape) {
    return shape.label === "healed" ? 1e9 : shape.label === BEFORE ? -2 : shape.days;
  }
  var BodyView = class {
    constructor(figure, letter) {
      const { vtk } = globalThis.cicatrixLibraries;
      Object.assign(this, { figure, vtk, scene: stored(letter, "body"), maps: stored(letter, "maps"), name: letter, arrays: /* @__PURE__ */ new Map() });
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
      onTheme(() => {
        this.renderer.setBackground(colourOf("--stage"));
        this.#tint();
        this.draw();
      });
      this.canvas.addEventListener("keydown", (event) => this.#key(event));
      figure.querySelector('[data-save="png"]').addEventListener("click", () => this.#savePicture());
      figure.querySelector('[data-save="csv"]').addEventListener("click", () => this.#saveData());
    }
    get isSolid() {
      return this.scene.dimension === 3;
    }
    get shapes() {
      return this.scene.shapes;
    }
    draw() {
      this.window.getRenderWindow().render();
    }
    // the shape in a position at a given time, or else the last one before it
    pick(position, label, at) {
      const own = this.shapes.filter((shape) => shape.position === position);
      const candidates = own.length ? own : this.shapes;
      const before = candidates.filter((shape) => rank(shape) <= at);
      return candidates.find((shape) => shape.label === label) ?? before.at(-1) ?? candidates[0];
    }
    async show({ position, label, at, colour, range, cut, ghost }) {
      const turn = this.turn = (this.turn ?? 0) + 1;
      const shape = this.pick(position, label, at);
      const surfaceOf = ({ surfaces }) => cut && surfaces.cut || surfaces.whole;
      const surface = surfaceOf(shape);
      const [points, triangles] = [await this.#array(surface.points), await this.#array(surface.triangles)];
      const [isCell, packed] = colour in surface.inCells ? [true, surface.inCells[colour]] : [false, surface.atPoints[colour]];
      const values = packed && await this.#array(packed);
      const old = this.shapes.find((other) => other.position === shape.position && other.label === BEFORE);
      const outline = old?.outline && await this.#array(old.outline);
      const oldPoints = old && await this.#array(surfaceOf(old).points);
      const oldTriangles = old && await this.#array(surfaceOf(old).triangles);
      if (turn !== this.turn) return;
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
        flat: this.scene.isDownward ? [[0, 0, -1], [0, -1, 0]] : [[0, 0, 1], [0, 1, 0]]
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
      this.camera.set({
        position: other.camera.getPosition(),
        focalPoint: other.camera.getFocalPoint(),
        viewUp: other.camera.getViewUp(),
        parallelScale: other.camera.getParallelScale(),
        viewAngle: other.camera.getViewAngle()
      });
      this.renderer.resetCameraClippingRange();
      this.draw();
    }
    #actor() {
      const mapper = this.vtk.Mapper.newInstance();
      const actor = this.vtk.Actor.newInstance();
      actor.setMapper(mapper);
      actor.getProperty().setAmbient(0.25);
      actor.getProperty().setDiffuse(0.75);
      return actor;
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
      stops.forEach((rgb, k) => table.addRGBPoint(low + (high - low) * k / (stops.length - 1), ...rgb));
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
  };
  var least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
  var greatest = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
  var mean = (points, triangles, t, c) => (points[3 * triangles[3 * t] + c] + points[3 * triangles[3 * t + 1] + c] + points[3 * triangles[3 * t + 2] + c]) / 3;
  function counted(cells, n) {
    const out = new Uint32Array(cells.length / n * (n + 1));
    for (let k = 0, at = 0; k < cells.length; k += n) {
      out[at++] = n;
      for (let j = 0; j < n; j++) out[at++] = cells[k + j];
    }
    return out;
  }
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

  // src/charts.js
  var COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#b59f00"];
  var WIDTH = 640;
  function draw(figure, name, options, head, rows) {
    const { Plot } = globalThis.cicatrixLibraries;
    const title = figure.querySelector("figcaption").textContent;
    const plot = Plot.plot({
      width: WIDTH,
      height: 300,
      marginLeft: 55,
      marginBottom: 42,
      grid: true,
      ariaLabel: title,
      style: { background: "none", color: "currentColor", fontSize: "13px" },
      ...options(Plot)
    });
    figure.querySelector(".plot").replaceChildren(plot);
    figure.querySelector('[data-save="svg"]').onclick = () => save(`${name}.svg`, svgText(figure), "image/svg+xml");
    figure.querySelector('[data-save="csv"]').onclick = () => save(`${name}.csv`, csv(head, rows), "text/csv");
    figure.dataset.drawn = "yes";
  }
  function svgText(figure) {
    const copy = [...figure.querySelectorAll(".plot svg")].at(-1).cloneNode(true);
    copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
    copy.style.color = "#111";
    copy.style.background = "#fff";
    return new XMLSerializer().serializeToString(copy);
  }
  function drawClosing(figure, runs) {
    const rows = runs.flatMap(({ letter, name, closing }) => closing.days.map((day, k) => ({ run: runs.length > 1 ? `${letter}: ${name}` : name, day, percent: closing.percent[k], size: closing.size[k] ?? "" })));
    const clinic = runs[0].closing.clinic.days.map((day, k) => ({ day, percent: runs[0].closing.clinic.percent[k] }));
    const names = [...new Set(rows.map((row) => row.run))];
    draw(figure, "closing", (Plot) => ({
      color: { domain: [...names, "clinical: cavity on MRI, day 23 = 100 %"], range: [...COLOURS.slice(0, names.length), "currentColor"], legend: true },
      x: { label: "days after surgery [days]" },
      y: { label: "still open [%]", domain: [0, 105] },
      marks: [
        Plot.ruleY([0]),
        Plot.lineY(rows, { x: "day", y: "percent", stroke: "run", strokeWidth: 2 }),
        Plot.dot(rows, { x: "day", y: "percent", fill: "run", r: 2.5 }),
        Plot.dot(clinic, { x: "day", y: "percent", symbol: "times", stroke: "currentColor", r: 5, strokeWidth: 2 }),
        Plot.tip(rows, Plot.pointerX({ x: "day", y: "percent", fill: "var(--paper)" }))
      ]
    }), ["run", "day", "open_percent", runs[0].closing.sizeName || "open_size"], rows.map((row) => [row.run, row.day, row.percent, row.size]));
  }
  function drawCurves(runs) {
    const home = document.getElementById("curves");
    if (!home || !runs.length) return;
    const columns = /* @__PURE__ */ new Map();
    for (const { curves } of runs) for (const column of curves.columns) if (column.name !== curves.over) columns.set(column.name, column);
    for (const [name, { label, unit }] of columns) {
      const figure = document.getElementById("curve").content.cloneNode(true).querySelector("figure");
      figure.querySelector("figcaption").textContent = withUnit(label, unit);
      figure.dataset.chart = name;
      home.append(figure);
      const rows = runs.flatMap((run) => series(run, name));
      const over = runs[0].curves.columns.find((column) => column.name === runs[0].curves.over);
      const names = runs.map((run) => run.letter);
      draw(figure, name, (Plot) => ({
        height: 220,
        color: { domain: names, range: COLOURS, legend: runs.length > 1 },
        x: { label: withUnit(over.label, over.unit) },
        y: { label: withUnit(label, unit) },
        marks: [Plot.lineY(rows, { x: "x", y: "y", stroke: "run", strokeWidth: 1.8 }), Plot.dot(rows, { x: "x", y: "y", fill: "run", r: rows.length > 200 ? 0 : 2 })]
      }), ["run", over.name, name], rows.map((row) => [row.run, row.x, row.y ?? ""]));
    }
  }
  function series({ letter, curves }, name) {
    const x = curves.columns.find((column) => column.name === curves.over).values;
    const y = curves.columns.find((column) => column.name === name)?.values ?? [];
    return y.map((value, k) => ({ run: letter, x: x[k], y: value }));
  }
  async function drawOutlines(letter) {
    const scene = stored(letter, "body");
    for (const figure of document.querySelectorAll('[data-chart^="outline-"]')) {
      const position = figure.dataset.chart.slice("outline-".length);
      const rows = [];
      const shapes = scene.shapes.filter((shape) => shape.position === position).sort((a, b) => rank(a) - rank(b));
      for (const shape of shapes) {
        const [points, edges] = [await unpack(shape.surfaces.whole.points), await unpack(shape.outline)];
        for (let k = 0; k < edges.length; k += 2) {
          const [a, b] = [3 * edges[k], 3 * edges[k + 1]];
          rows.push({ moment: shape.label, x1: points[a], y1: points[a + 1], x2: points[b], y2: points[b + 1] });
        }
      }
      const moments = shapes.map((shape) => shape.label);
      draw(figure, figure.dataset.chart, (Plot) => ({
        height: void 0,
        aspectRatio: 1,
        color: { domain: moments, range: COLOURS, legend: true },
        x: { label: `${scene.axes[0]} [mm]` },
        y: { label: `${scene.axes[1]} [mm]`, reverse: scene.isDownward },
        marks: [Plot.link(rows, { x1: "x1", y1: "y1", x2: "x2", y2: "y2", stroke: "moment", strokeWidth: 1.8 })]
      }), ["moment", "x1_mm", "y1_mm", "x2_mm", "y2_mm"], rows.map((row) => Object.values(row)));
    }
  }

  // src/webgl.js
  var WORDS = "This browser offers no WebGL2, so nothing can be turned or moved here (it may be switched off, or the graphics driver may be blocked).";
  var hasWebGL2 = () => {
    const context = document.createElement("canvas").getContext("webgl2");
    context?.getExtension("WEBGL_lose_context")?.loseContext();
    return Boolean(context);
  };
  function standStill(figure, controls, { alive = "", otherwise = "The numbers on this page, and figures.pdf, do not need it." } = {}) {
    figure.dataset.still = "yes";
    const still = figure.querySelector(".still");
    if (still) still.hidden = false;
    for (const dead of figure.querySelectorAll(".canvas, .slices, .scale, figcaption, .said, .downloads")) dead.hidden = true;
    if (alive) {
      figure.querySelector(".downloads").hidden = false;
      for (const button of figure.querySelectorAll(".downloads button")) button.hidden = !button.matches(alive);
    }
    for (const element2 of controls) element2.hidden = true;
    const instead = still ? "The picture is the run's own figure." : otherwise;
    const words = Object.assign(document.createElement("p"), { className: "gap", textContent: `${WORDS} ${instead}` });
    words.setAttribute("role", "status");
    figure.prepend(words);
  }

  // src/controls.js
  async function startBodies() {
    const figures = [...document.querySelectorAll("[data-body]")];
    if (!figures.length) return;
    if (!hasWebGL2()) {
      for (const figure of figures) standStill(figure, document.querySelectorAll("[data-body-controls]"));
      return;
    }
    const views = figures.map((figure) => new BodyView(figure, figure.dataset.body));
    const controls = new Controls(views);
    await controls.show();
    if (views.length > 1) link(views);
  }
  var Controls = class {
    constructor(views) {
      this.views = views;
      const shapes = views.flatMap((view) => view.shapes);
      const labels = new Map(shapes.map((shape) => [shape.label, rank(shape)]));
      this.moments = [...labels].sort((a, b) => a[1] - b[1]);
      this.colours = merged(views);
      this.#slider();
      this.#positions([...new Set(shapes.map((shape) => shape.position))]);
      this.#select();
      const isSolid = views.some((view) => view.isSolid);
      document.getElementById("views").hidden = document.getElementById("cut-choice").hidden = !isSolid;
      const hasBefore = labels.has(BEFORE);
      document.getElementById("ghost").parentElement.hidden = !hasBefore;
      for (const id of ["moment", "colour", "cut", "ghost"]) document.getElementById(id).addEventListener("input", () => this.show());
      for (const button of document.querySelectorAll("[data-view]")) {
        button.addEventListener("click", () => views.forEach((view) => view.view(button.dataset.view)));
      }
    }
    async show() {
      const [label, at] = this.moments[Number(this.slider.value)];
      document.getElementById("moment-name").textContent = label;
      this.slider.setAttribute("aria-valuetext", label);
      const colour = document.getElementById("colour").value;
      const range = this.colours.find((entry) => entry.name === colour)?.range;
      const position = document.querySelector('input[name="position"]:checked').value;
      const [cut, ghost] = ["cut", "ghost"].map((id) => document.getElementById(id).checked);
      await Promise.all(this.views.map((view) => view.show({ position, label, at, colour, range, cut, ghost })));
    }
    #slider() {
      this.slider = document.getElementById("moment");
      this.slider.max = this.moments.length - 1;
      this.slider.value = this.moments.length - 1;
      this.slider.closest(".control").hidden = this.moments.length < 2;
    }
    #positions(names) {
      const home = document.getElementById("positions");
      for (const [k, name] of names.entries()) {
        const label = document.createElement("label");
        const input = Object.assign(document.createElement("input"), { type: "radio", name: "position", value: name, checked: k === 0 });
        input.addEventListener("input", () => this.show());
        label.append(input, ` ${name}`);
        home.append(label);
      }
      home.closest("fieldset").hidden = names.length < 2;
    }
    #select() {
      const select = document.getElementById("colour");
      for (const { name, label, unit } of this.colours) {
        select.append(new Option(unit === "1" ? label : `${label} [${unit}]`, name));
      }
      select.append(new Option("none", ""));
    }
  };
  function merged(views) {
    const all = /* @__PURE__ */ new Map();
    for (const colour of views.flatMap((view) => view.scene.colours)) {
      const known = all.get(colour.name) ?? { ...colour };
      known.range = [Math.min(known.range[0], colour.range[0]), Math.max(known.range[1], colour.range[1])];
      all.set(colour.name, known);
    }
    return [...all.values()];
  }
  function link(views) {
    let isFollowing = false;
    for (const view of views) {
      view.camera.onModified(() => {
        if (isFollowing) return;
        isFollowing = true;
        for (const other of views) if (other !== view && other.isSolid === view.isSolid) other.follow(view);
        isFollowing = false;
      });
    }
  }

  // src/slices.js
  var LABEL_COLOURS = [[0, 0, 0], [240, 228, 66], [0, 158, 115], [204, 121, 167], [213, 94, 0], [86, 180, 233]];
  var ZONES = ["", "excised", "margin (should be free of tumour)"];
  var ZONE_COLOURS = [[0, 0, 0], [230, 40, 40], [255, 170, 60]];
  var STEPS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
  var Slices = class {
    constructor(figure, content) {
      Object.assign(this, { figure, content, canvas: figure.querySelector("canvas"), layers: Object.keys(content.volumes) });
      figure.querySelector('[data-save="nifti"]')?.addEventListener("click", () => this.#saveVolumes());
    }
    async start() {
      const { Niivue, NVImage, SHOW_RENDER, SLICE_TYPE } = globalThis.cicatrixLibraries;
      this.nv = new Niivue({
        backColor: [...colourOf("--stage"), 1],
        crosshairColor: [0.9, 0.9, 0.2, 0.9],
        dragAndDropEnabled: false,
        isRadiologicalConvention: true,
        loadingText: "",
        crosshairWidth: 0.5,
        multiplanarShowRender: SHOW_RENDER.NEVER,
        show3Dcrosshair: false
      });
      this.nv.onLocationChange = (where) => this.#moved(where);
      await this.nv.attachToCanvas(this.canvas);
      this.nv.setSliceType(SLICE_TYPE.MULTIPLANAR);
      for (const name of this.layers) {
        const image = await NVImage.loadFromBase64({ base64: this.content.volumes[name], name: `${name}.nii.gz`, ...this.#look(name) });
        if (name === "labels") image.setColormapLabel(lookup(LABEL_COLOURS, this.content.labels));
        if (name === "zones") image.setColormapLabel(lookup(ZONE_COLOURS, ZONES));
        this.nv.addVolume(image);
      }
      if (this.content.centre) this.goTo(this.content.centre);
      onTheme(() => {
        this.nv.opts.backColor = [...colourOf("--stage"), 1];
        this.nv.drawScene();
      });
      this.canvas.addEventListener("keydown", (event) => this.#key(event));
      this.figure.querySelector('[data-save="png"]')?.addEventListener("click", () => this.nv.saveScene("slices.png"));
      this.figure.dataset.drawn = this.layers.join(", ");
      return this;
    }
    // move the crosshair to a point (3,) LPS [mm]
    goTo([x, y, z]) {
      this.nv.scene.crosshairPos = this.nv.mm2frac([-x, -y, z]);
      this.nv.drawScene();
      this.nv.createOnLocationChange();
    }
    setOpacity(name, opacity) {
      const k = this.layers.indexOf(name);
      if (k >= 0) this.nv.setOpacity(k, opacity);
    }
    #look(name) {
      return name === "picture" ? { colormap: "gray", cal_min: 0, cal_max: 255 } : { opacity: name === "labels" ? 0.35 : 0.5 };
    }
    #moved(where) {
      const [x, y, z] = where.mm;
      this.point = [-x, -y, z];
      const values = Object.fromEntries(this.layers.map((name, k) => [name, Math.round(where.values[k]?.value ?? 0)]));
      const label = this.content.labels[values.labels] ?? "";
      const zone = ZONES[values.zones] ?? "";
      const place = `${Math.abs(x).toFixed(0)} mm ${x < 0 ? "left" : "right"}, ${Math.abs(y).toFixed(0)} mm ${y > 0 ? "anterior" : "posterior"}, ${Math.abs(z).toFixed(0)} mm ${z > 0 ? "superior" : "inferior"}`;
      this.figure.querySelector(".said").textContent = `${place} of the image's origin: ${[label, zone].filter(Boolean).join(", ") || "nothing labelled"}.`;
      this.onPoint?.(this.point);
    }
    #key(event) {
      const step = STEPS[event.key];
      if (!step) return;
      event.preventDefault();
      this.nv.moveCrosshairInVox(...step);
    }
    #saveVolumes() {
      for (const name of this.layers) save(`${name}.nii.gz`, bytesOf(this.content.volumes[name]), "application/gzip");
    }
  };
  function lookup(colours, labels) {
    const channel = (k) => colours.map((rgb) => rgb[k]);
    return { R: channel(0), G: channel(1), B: channel(2), A: colours.map((_, k) => k ? 255 : 0), I: colours.map((_, k) => k), labels: [...labels].slice(0, colours.length) };
  }
  function writeKey(home, content) {
    const entries = content.volumes.labels ? content.labels.map((name, k) => [name, LABEL_COLOURS[k]]).slice(1) : [];
    const zones = content.volumes.zones ? ZONES.map((name, k) => [name, ZONE_COLOURS[k]]).slice(1) : [];
    for (const [name, rgb] of [...entries, ...zones]) {
      const swatch = document.createElement("span");
      swatch.className = "swatch";
      swatch.style.background = `rgb(${rgb.join(" ")})`;
      home.append(swatch, `${name} `);
    }
  }
  async function startSlices() {
    const figure = document.querySelector("[data-slices]");
    if (!figure) return;
    const content = stored(figure.dataset.slices, "slices");
    const slices = new Slices(figure, content);
    if (!hasWebGL2()) {
      standStill(figure, document.querySelectorAll("[data-slices-controls]"), { alive: '[data-save="nifti"]' });
      return;
    }
    await slices.start();
    writeKey(document.getElementById("label-key"), content);
    startOpacity(slices);
  }
  function startOpacity(slices) {
    const opacity = document.getElementById("opacity");
    const told = () => {
      document.getElementById("opacity-value").textContent = `${Math.round(100 * opacity.value)} %`;
      slices.setOpacity("labels", Number(opacity.value));
    };
    opacity.addEventListener("input", told);
    told();
    const zones = document.getElementById("zones");
    zones?.addEventListener("input", () => slices.setOpacity("zones", zones.checked ? 0.5 : 0));
  }

  // src/plan.js
  var WATCH_MS = 1e3;
  var SETTLE_MS = 150;
  var element = (id) => document.getElementById(id);
  async function ask(act, content = {}) {
    const answer = await fetch(act, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });
    const found = await answer.json();
    if (!answer.ok) throw new Error(found.error);
    return found;
  }
  function settled(act) {
    let waiting;
    return () => {
      clearTimeout(waiting);
      waiting = setTimeout(act, SETTLE_MS);
    };
  }
  var Plan = class {
    constructor(slices, content) {
      Object.assign(this, { slices, content });
      this.volume = slices?.nv.volumes[slices.layers.indexOf("zones")];
      this.#write(content.centre);
      this.measure = settled(() => this.#measured());
      if (slices) slices.onPoint = (point) => {
        if (element("follow").checked && !this.isMoving) this.#place(point);
      };
      for (const id of ["x", "y", "z"]) element(id).addEventListener("change", () => this.#typed());
      for (const id of ["radius", "margin"]) element(id).addEventListener("input", () => this.#changed());
      element("save").addEventListener("click", () => this.#told(async () => {
        const { case: name, folder } = await ask("save", this.wish);
        return `Saved as ${name} in ${folder}.`;
      }));
      element("start").addEventListener("click", () => this.#told(async () => {
        const { case: name } = await ask("start", this.wish);
        this.watch();
        return `Started ${name}.`;
      }));
      element("stop").addEventListener("click", () => this.#told(async () => {
        element("told").textContent = "Stopping; waiting until the state is saved ...";
        const { sentence } = await ask("stop");
        return sentence;
      }));
      element("report").addEventListener("click", () => this.#told(async () => {
        element("told").textContent = "Writing the report ...";
        const { page } = await ask("report");
        const link2 = Object.assign(document.createElement("a"), { href: page, target: "_blank", rel: "noopener", textContent: "Open the report", id: "report-link" });
        element("told").replaceChildren(link2);
        return null;
      }));
      this.#changed();
      this.watch();
    }
    get centre() {
      return ["x", "y", "z"].map((id) => Number(element(id).value));
    }
    get wish() {
      return {
        centre_mm: this.centre,
        radius_mm: Number(element("radius").value),
        margin_mm: Number(element("margin").value),
        dimension: Number(element("dimension").value),
        model: element("model").value,
        mode: element("mode").value
      };
    }
    async watch() {
      clearTimeout(this.waiting);
      try {
        this.#progress(await ask("progress"));
      } catch (fault) {
        element("told").textContent = `The server does not answer (${fault.message}); run cicatrix plan again.`;
        return;
      }
      this.waiting = setTimeout(() => this.watch(), WATCH_MS);
    }
    #write(centre) {
      ["x", "y", "z"].forEach((id, k) => {
        element(id).value = centre[k].toFixed(1);
      });
    }
    #place(point) {
      this.#write(point);
      this.#changed();
    }
    #typed() {
      this.isMoving = true;
      this.slices?.goTo(this.centre);
      this.isMoving = false;
      this.#changed();
    }
    #changed() {
      for (const id of ["radius", "margin"]) element(`${id}-value`).textContent = `${Number(element(id).value).toFixed(1)} mm`;
      this.#paint();
      this.measure();
    }
    // write the ball and its margin into the voxels of the zones layer
    #paint() {
      if (!this.slices) return;
      const { shape, spacing, origin } = this.content.grid;
      const { centre, wish } = this;
      const image = this.volume.img;
      image.fill(0);
      const span = [0, 1, 2].map((k) => [-1, 1].map((side) => (centre[k] + side * wish.radius_mm - origin[k]) / spacing[k]));
      const [low, high] = [span.map(([a], k) => Math.max(0, Math.ceil(a))), span.map(([, b], k) => Math.min(shape[k] - 1, Math.floor(b)))];
      for (let z = low[2]; z <= high[2]; z++) {
        for (let y = low[1]; y <= high[1]; y++) {
          for (let x = low[0]; x <= high[0]; x++) {
            const away = Math.hypot(...[x, y, z].map((n, k) => origin[k] + n * spacing[k] - centre[k]));
            if (away <= wish.radius_mm) image[x + shape[0] * (y + shape[1] * z)] = away > wish.radius_mm - wish.margin_mm ? 2 : 1;
          }
        }
      }
      this.slices.nv.updateGLVolume();
    }
    async #measured() {
      try {
        const found = await ask("measure", this.wish);
        element("removed").textContent = `${found.removed_ml.toFixed(1)} ml`;
        element("percent").textContent = `${found.percent.toFixed(1)} % of ${found.breast_ml.toFixed(0)} ml`;
        element("tumour-margin").textContent = found.margin_mm === null ? "no tumour is labelled" : `${short(found.margin_mm)} mm`;
        const outside = found.depth_mm < 0;
        element("depth").textContent = outside ? `outside, ${short(-found.depth_mm)} mm from the breast` : `${found.depth_mm.toFixed(1)} mm`;
        element("against").replaceChildren(...found.warnings.map((words) => Object.assign(document.createElement("li"), { textContent: words })));
      } catch (fault) {
        element("against").replaceChildren(Object.assign(document.createElement("li"), { textContent: fault.message }));
      }
    }
    async #told(act) {
      try {
        const words = await act();
        if (words !== null) element("told").textContent = words;
      } catch (fault) {
        element("told").textContent = fault.message;
      }
    }
    #progress({ case: name, state, sentence, lines, days, closed }) {
      const isRunning = state === "running";
      element("stop").disabled = !isRunning;
      element("start").disabled = isRunning;
      element("report").disabled = state === "idle" || isRunning && !closed.length;
      const share = closed.length ? 100 * closed.at(-1) : 0;
      element("closed").value = share;
      element("closed-value").textContent = closed.length ? `day ${short(days.at(-1))}: ${share.toFixed(0)} % closed` : "";
      element("log").textContent = lines.join("\n");
      if (this.state && this.state !== state && !isRunning) element("told").textContent = `${name}: ${state}. ${sentence}`;
      this.state = document.body.dataset.run = state;
    }
  };
  async function startPlan() {
    const content = stored("A", "slices");
    const figure = document.querySelector("[data-slices]");
    if (!hasWebGL2()) {
      standStill(figure, document.querySelectorAll("[data-slices-controls]"), { otherwise: "The resection can be placed by its numbers." });
      globalThis.cicatrixPlan = new Plan(null, content);
      return;
    }
    const slices = await new Slices(figure, content).start();
    writeKey(element("label-key"), content);
    startOpacity(slices);
    globalThis.cicatrixPlan = new Plan(slices, content);
  }

  // src/main.js
  async function attempt(where, part) {
    try {
      await part();
    } catch (fault) {
      console.error(fault);
      const words = document.createElement("p");
      words.className = "gap";
      words.textContent = `This part could not be drawn (${fault.message}). The figures at the end of the page and in figures.pdf show the same results.`;
      document.querySelector(where)?.append(words);
    }
  }
  function runsWith(name) {
    const all = document.body.dataset.page === "compare" ? [..."ABCDEFGH"] : [document.body.dataset.letter];
    const heads = [...document.querySelectorAll(".runs > li")].map((item) => item.querySelector("a").textContent);
    return all.filter((letter) => stored(letter, name)).map((letter) => ({
      letter,
      name: heads["ABCDEFGH".indexOf(letter)] ?? document.querySelector("h1").textContent,
      [name]: stored(letter, name)
    }));
  }
  document.addEventListener("DOMContentLoaded", async () => {
    startTheme();
    if (document.body.dataset.page === "plan") {
      await attempt(".plan", startPlan);
      document.body.dataset.ready = "yes";
      return;
    }
    await attempt("[data-body]", startBodies);
    document.body.dataset.firstPicture = String(Math.round(performance.now()));
    const closing = document.querySelector('[data-chart="closing"]');
    if (closing) await attempt('[data-chart="closing"]', () => drawClosing(closing, runsWith("closing")));
    await attempt("#curves", () => drawCurves(runsWith("curves")));
    if (document.querySelector('[data-chart^="outline-"]')) await attempt('[data-chart^="outline-"]', () => drawOutlines(document.body.dataset.letter));
    await attempt("[data-slices]", startSlices);
    document.body.dataset.ready = "yes";
  });
})();
