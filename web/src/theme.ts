/** Light and dark: as the system says, or as the switch says. */
import { h } from "./dom";

type Theme = "light" | "dark";
const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners: (() => void)[] = [];

/** Call back whenever colours change. */
export function onTheme(listener: () => void): void {
  listeners.push(listener);
}

const known = new Map<string, string>();

/** Return the value of a custom property of the style, as a colour. */
export function colour(name: string): string {
  let value = known.get(name);
  if (value === undefined) {
    value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    known.set(name, value);
  }
  return value;
}

export function current(): Theme {
  return document.documentElement.dataset.theme === "dark" ? "dark" : "light";
}

function set(theme: Theme): void {
  document.documentElement.dataset.theme = theme;
  known.clear();
  for (const listener of listeners) listener();
}

/** Return the switch between light and dark. */
export function themeSwitch(): HTMLElement {
  set(dark.matches ? "dark" : "light");
  let chosen = false;
  const button = h("button", { type: "button", class: "theme" });
  const show = (): void => {
    const other = current() === "dark" ? "Light" : "Dark";
    button.textContent = `${other === "Light" ? "☀" : "☾"} ${other}`;
    button.setAttribute("aria-label", `${other} colours`);
  };
  button.addEventListener("click", () => {
    chosen = true;
    set(current() === "dark" ? "light" : "dark");
    show();
  });
  dark.addEventListener("change", () => {
    if (!chosen) set(dark.matches ? "dark" : "light");
    show();
  });
  show();
  return button;
}
