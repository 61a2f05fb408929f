// Without WebGL2 a part cannot be drawn: its static figure takes its place, and what would control it is hidden.
const WORDS = "This browser offers no WebGL2, so nothing can be turned or moved here (it may be switched off, or the graphics driver may be blocked).";

export const hasWebGL2 = () => {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext(); // a browser gives sixteen at most
  return Boolean(context);
};

// show the static figure of a stage, and a sentence; hide what is dead without a drawing, but keep the elements of `alive`
export function standStill(figure, controls, { alive = "", otherwise = "The numbers on this page, and figures.pdf, do not need it." } = {}) {
  figure.dataset.still = "yes";
  const still = figure.querySelector(".still");
  if (still) still.hidden = false;
  for (const dead of figure.querySelectorAll(".canvas, .slices, .scale, figcaption, .said, .downloads")) dead.hidden = true;
  if (alive) {
    figure.querySelector(".downloads").hidden = false;
    for (const button of figure.querySelectorAll(".downloads button")) button.hidden = !button.matches(alive);
  }
  for (const element of controls) element.hidden = true;
  const instead = still ? "The picture is the run's own figure." : otherwise;
  const words = Object.assign(document.createElement("p"), { className: "gap", textContent: `${WORDS} ${instead}` });
  words.setAttribute("role", "status");
  figure.prepend(words);
}
