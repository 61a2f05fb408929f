// Planning page: place a ball on the slices, measure what it removes, and start and watch the run.
import { short, stored } from "./data.js";
import { Slices, startOpacity, writeKey } from "./slices.js";
import { hasWebGL2, standStill } from "./webgl.js";

const WATCH_MS = 1000;
const SETTLE_MS = 150; // wait after the last change before a request to the server
const element = (id) => document.getElementById(id);

async function ask(act, content = {}) {
  const answer = await fetch(act, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
}

// return a function that calls act once, SETTLE_MS after the last of many events
function settled(act) {
  let waiting;
  return () => { clearTimeout(waiting); waiting = setTimeout(act, SETTLE_MS); };
}

class Plan {
  constructor(slices, content) {
    Object.assign(this, { slices, content });
    this.volume = slices?.nv.volumes[slices.layers.indexOf("zones")];
    this.#write(content.centre);
    this.measure = settled(() => this.#measured());
    if (slices) slices.onPoint = (point) => { if (element("follow").checked && !this.isMoving) this.#place(point); };
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
      const link = Object.assign(document.createElement("a"), { href: page, target: "_blank", rel: "noopener", textContent: "Open the report", id: "report-link" });
      element("told").replaceChildren(link);
      return null;
    }));
    this.#changed();
    this.watch();
  }

  get centre() { return ["x", "y", "z"].map((id) => Number(element(id).value)); }

  get wish() {
    return { centre_mm: this.centre, radius_mm: Number(element("radius").value), margin_mm: Number(element("margin").value),
      dimension: Number(element("dimension").value), model: element("model").value, mode: element("mode").value };
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
    ["x", "y", "z"].forEach((id, k) => { element(id).value = centre[k].toFixed(1); });
  }

  #place(point) {
    this.#write(point);
    this.#changed();
  }

  #typed() {
    this.isMoving = true; // moving the crosshair raises the same event as a click, which is ignored here
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
    element("report").disabled = state === "idle" || (isRunning && !closed.length);
    const share = closed.length ? 100 * closed.at(-1) : 0;
    element("closed").value = share;
    element("closed-value").textContent = closed.length ? `day ${short(days.at(-1))}: ${share.toFixed(0)} % closed` : "";
    element("log").textContent = lines.join("\n");
    if (this.state && this.state !== state && !isRunning) element("told").textContent = `${name}: ${state}. ${sentence}`;
    this.state = document.body.dataset.run = state;
  }
}

export async function startPlan() {
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
