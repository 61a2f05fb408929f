// Curves as SVG, with units on the axes, colours for colour-blind readers, and downloads of picture and data.
import { csv, save, stored, unpack, withUnit } from "./data.js";
import { rank } from "./body.js";

export const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#b59f00"]; // Okabe & Ito 2008
const WIDTH = 640;

// draw a plot into a figure; head and rows go into its CSV file
function draw(figure, name, options, head, rows) {
  const { Plot } = globalThis.cicatrixLibraries;
  const title = figure.querySelector("figcaption").textContent;
  const plot = Plot.plot({ width: WIDTH, height: 300, marginLeft: 55, marginBottom: 42, grid: true, ariaLabel: title,
    style: { background: "none", color: "currentColor", fontSize: "13px" }, ...options(Plot) });
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

// runs: [{letter, name, closing}]
export function drawClosing(figure, runs) {
  const rows = runs.flatMap(({ letter, name, closing }) =>
    closing.days.map((day, k) => ({ run: runs.length > 1 ? `${letter}: ${name}` : name, day, percent: closing.percent[k], size: closing.size[k] ?? "" })));
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
      Plot.tip(rows, Plot.pointerX({ x: "day", y: "percent", fill: "var(--paper)" })),
    ],
  }), ["run", "day", "open_percent", runs[0].closing.sizeName || "open_size"], rows.map((row) => [row.run, row.day, row.percent, row.size]));
}

// one small chart per column of the runs' histories
export function drawCurves(runs) {
  const home = document.getElementById("curves");
  if (!home || !runs.length) return;
  const columns = new Map();
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
      marks: [Plot.lineY(rows, { x: "x", y: "y", stroke: "run", strokeWidth: 1.8 }), Plot.dot(rows, { x: "x", y: "y", fill: "run", r: rows.length > 200 ? 0 : 2 })],
    }), ["run", over.name, name], rows.map((row) => [row.run, row.x, row.y ?? ""]));
  }
}

function series({ letter, curves }, name) {
  const x = curves.columns.find((column) => column.name === curves.over).values;
  const y = curves.columns.find((column) => column.name === name)?.values ?? [];
  return y.map((value, k) => ({ run: letter, x: x[k], y: value }));
}

// outlines of a section at all times in one chart per position
export async function drawOutlines(letter) {
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
      height: undefined,
      aspectRatio: 1,
      color: { domain: moments, range: COLOURS, legend: true },
      x: { label: `${scene.axes[0]} [mm]` },
      y: { label: `${scene.axes[1]} [mm]`, reverse: scene.isDownward },
      marks: [Plot.link(rows, { x1: "x1", y1: "y1", x2: "x2", y2: "y2", stroke: "moment", strokeWidth: 1.8 })],
    }), ["moment", "x1_mm", "y1_mm", "x2_mm", "y2_mm"], rows.map((row) => Object.values(row)));
  }
}

