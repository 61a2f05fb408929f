// Controls of one or several bodies: time, position, colour, cut, overlay and view; all bodies share them and one colour scale.
import { BEFORE, BodyView, rank } from "./body.js";
import { hasWebGL2, standStill } from "./webgl.js";

export async function startBodies() {
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

class Controls {
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
}

function merged(views) {
  const all = new Map();
  for (const colour of views.flatMap((view) => view.scene.colours)) {
    const known = all.get(colour.name) ?? { ...colour };
    known.range = [Math.min(known.range[0], colour.range[0]), Math.max(known.range[1], colour.range[1])];
    all.set(colour.name, known);
  }
  return [...all.values()];
}

// rotating one view rotates the others
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
