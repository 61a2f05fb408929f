// Three slices of the image through one point, overlaid with labels and the resection.
import { bytesOf, save, stored } from "./data.js";
import { colourOf, onTheme } from "./theme.js";
import { hasWebGL2, standStill } from "./webgl.js";

const LABEL_COLOURS = [[0, 0, 0], [240, 228, 66], [0, 158, 115], [204, 121, 167], [213, 94, 0], [86, 180, 233]]; // Okabe & Ito 2008
const ZONES = ["", "excised", "margin (should be free of tumour)"];
const ZONE_COLOURS = [[0, 0, 0], [230, 40, 40], [255, 170, 60]];
const STEPS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };

export class Slices {
  constructor(figure, content) {
    Object.assign(this, { figure, content, canvas: figure.querySelector("canvas"), layers: Object.keys(content.volumes) });
    figure.querySelector('[data-save="nifti"]')?.addEventListener("click", () => this.#saveVolumes());
  }

  async start() {
    const { Niivue, NVImage, SHOW_RENDER, SLICE_TYPE } = globalThis.cicatrixLibraries;
    this.nv = new Niivue({ backColor: [...colourOf("--stage"), 1], crosshairColor: [0.9, 0.9, 0.2, 0.9], dragAndDropEnabled: false,
      isRadiologicalConvention: true, loadingText: "", crosshairWidth: 0.5, multiplanarShowRender: SHOW_RENDER.NEVER, show3Dcrosshair: false });
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
    onTheme(() => { this.nv.opts.backColor = [...colourOf("--stage"), 1]; this.nv.drawScene(); });
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
}

function lookup(colours, labels) {
  const channel = (k) => colours.map((rgb) => rgb[k]);
  return { R: channel(0), G: channel(1), B: channel(2), A: colours.map((_, k) => (k ? 255 : 0)), I: colours.map((_, k) => k), labels: [...labels].slice(0, colours.length) };
}

// write the colour key of labels and zones
export function writeKey(home, content) {
  const entries = content.volumes.labels ? content.labels.map((name, k) => [name, LABEL_COLOURS[k]]).slice(1) : [];
  const zones = content.volumes.zones ? ZONES.map((name, k) => [name, ZONE_COLOURS[k]]).slice(1) : [];
  for (const [name, rgb] of [...entries, ...zones]) {
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.style.background = `rgb(${rgb.join(" ")})`;
    home.append(swatch, `${name} `);
  }
}

export async function startSlices() {
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

export function startOpacity(slices) {
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
