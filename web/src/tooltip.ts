/** One tooltip for the page: on hover and on focus, it stays under the pointer, Escape closes it. */
import { h } from "./dom";
import { explanationOf } from "./number";

const SELECTOR = ".figure, .term";

function fill(tip: HTMLElement, element: Element): boolean {
  const explanation = explanationOf(element);
  if (!explanation) return false;
  const { label, text, unit, sound } = explanation;
  const path = element.getAttribute("data-field");
  const value = element.getAttribute("value");
  tip.replaceChildren(
    h("strong", {}, unit ? `${label} (${unit})` : label),
    h("p", {}, text),
    sound ? h("p", { class: "sound" }, "Sound recordings: ", sound) : "",
    path ? h("code", {}, `run.json: ${pathText(JSON.parse(path))} = ${value}`) : "",
  );
  return true;
}

/** Return a path as it is written in docs/run-json.md. */
export function pathText(path: (string | number)[]): string {
  return path
    .map((part, i) => (typeof part === "number" ? `[${part}]` : i ? `.${part}` : part))
    .join("");
}

function place(tip: HTMLElement, element: Element): void {
  const box = element.getBoundingClientRect();
  const { offsetWidth: width, offsetHeight: height } = tip;
  const left = Math.min(Math.max(8, box.left + box.width / 2 - width / 2), innerWidth - width - 8);
  const above = box.top - height - 8;
  tip.style.left = `${left}px`;
  tip.style.top = `${above > 8 ? above : box.bottom + 8}px`;
}

/** Let every number and every heading of numbers show what it means. */
export function startTooltip(root: HTMLElement): void {
  const tip = h("div", { role: "tooltip", id: "tip", class: "tip", hidden: true });
  root.append(tip);
  let owner: Element | null = null;
  let timer = 0;
  const hide = (): void => {
    owner?.removeAttribute("aria-describedby");
    owner = null;
    tip.hidden = true;
  };
  const show = (element: Element): void => {
    clearTimeout(timer);
    if (element === owner) return;
    hide();
    if (!fill(tip, element)) return;
    owner = element;
    element.setAttribute("aria-describedby", "tip");
    tip.hidden = false;
    place(tip, element);
  };
  const find = (event: Event): Element | null => (event.target as Element).closest?.(SELECTOR);
  document.addEventListener("pointerover", (event) => {
    const element = find(event);
    if (element) show(element);
    else if (tip.contains(event.target as Node)) clearTimeout(timer);
    else if (owner && owner !== document.activeElement) {
      clearTimeout(timer);
      timer = window.setTimeout(hide, 150);
    }
  });
  document.addEventListener("focusin", (event) => {
    const element = find(event);
    if (element) show(element);
    else hide();
  });
  document.addEventListener("focusout", hide);
  document.addEventListener("keydown", (event) => event.key === "Escape" && hide());
  const stay = (): void => {
    if (owner && owner === document.activeElement) place(tip, owner);
    else hide();
  };
  addEventListener("scroll", stay, { passive: true });
}
