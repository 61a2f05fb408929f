// Start all parts of a page; a part that fails shows a message in its place, and the others still start.
import { drawClosing, drawCurves, drawOutlines } from "./charts.js";
import { startBodies } from "./controls.js";
import { stored } from "./data.js";
import { startPlan } from "./plan.js";
import { startSlices } from "./slices.js";
import { startTheme } from "./theme.js";

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
    letter, name: heads["ABCDEFGH".indexOf(letter)] ?? document.querySelector("h1").textContent, [name]: stored(letter, name),
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
