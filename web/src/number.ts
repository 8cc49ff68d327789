/** Numbers of run.json in the page: each says where it is from and what it means. */
import { h, type Child } from "./dom";
import { explain, type Explanation } from "./explain";
import type { Json } from "./run";

export type Path = readonly (string | number)[];

let run: Json = null;
const explanations = new WeakMap<Element, Explanation>();

/** Say which run.json the paths are within. */
export function setRun(value: Json): void {
  run = value;
}

/** Return the value at a path of run.json, or undefined. */
export function lookUp(path: Path): Json | undefined {
  let value: Json | undefined = run;
  for (const part of path) {
    if (value === null || typeof value !== "object") return undefined;
    value = (value as Record<string, Json>)[String(part)];
  }
  return value;
}

/** Return a number as people read it: three digits, whole numbers in full. */
export function format(value: number): string {
  if (Number.isInteger(value)) return value.toLocaleString("en-US");
  const size = Math.abs(value);
  if (size >= 1000) return Math.round(value).toLocaleString("en-US");
  if (size < 1e-3) return value.toExponential(1).replaceAll("-", "−");
  return String(Number(value.toPrecision(3))).replace("-", "−");
}

/** Return what a value of run.json is in words. */
function words(value: Json | undefined): string {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return format(value);
  if (typeof value === "boolean") return value ? "yes" : "no";
  return typeof value === "string" && value ? value : JSON.stringify(value);
}

/** Return an element that shows the value at a path of run.json, with its explanation.
 *
 * `scale`: it is shown so many times as large (100 for a share in percent).
 * `quiet`: not a stop of the tab key, in tables whose headings explain it.
 */
export function figure(path: Path, { unit = "", quiet = false, name = "", scale = 1 } = {}): HTMLElement {
  const value = lookUp(path);
  const text = typeof value === "number" ? format(scale * value) : words(value);
  const known = value !== null && value !== undefined;
  const explanation = explain(path);
  const element = h(
    "data",
    {
      class: known ? "figure" : "figure unknown",
      value: JSON.stringify(value ?? null),
      "data-field": JSON.stringify(path),
      "data-unexplained": !explanation,
      "data-scale": scale === 1 ? undefined : scale,
      tabindex: quiet ? undefined : 0,
      role: quiet ? undefined : "note",
      "aria-label": quiet ? undefined : `${name || explanation?.label || path.at(-1)}: ${text}${unit}`,
    },
    text,
    known && unit ? h("span", { class: "unit" }, unit) : null,
  );
  if (explanation) explanations.set(element, explanation);
  return element;
}

/** Return a heading that explains the numbers below it, on hover and on focus. */
export function term(label: Child, explanation: Explanation | null): HTMLElement {
  if (!explanation) return h("span", {}, label);
  const element = h("span", { class: "term", tabindex: 0, role: "note" }, label);
  explanations.set(element, explanation);
  return element;
}

/** Return what an element means: the tooltip asks. */
export function explanationOf(element: Element): Explanation | undefined {
  return explanations.get(element);
}
