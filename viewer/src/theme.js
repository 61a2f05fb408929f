// Light or dark theme: that of the system until the user presses the button.
const listeners = [];
export const onTheme = (listener) => listeners.push(listener);

export function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen === "auto" ? matchMedia("(prefers-color-scheme: dark)").matches : chosen === "dark";
}

export function startTheme() {
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

// colour variable of the style sheet as three numbers from 0 to 1
export function colourOf(name) {
  const probe = document.createElement("span");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const found = getComputedStyle(probe).color.match(/[\d.]+/g).slice(0, 3).map((c) => Number(c) / 255);
  probe.remove();
  return found;
}
