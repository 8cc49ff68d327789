/** Elements are made here and nowhere else: what comes from files is text, never markup. */

export type Child = Node | string | null | undefined | false;
type Listeners = { [K in keyof HTMLElementEventMap]?: (event: HTMLElementEventMap[K]) => void };

export interface Props {
  /** Attributes by name; true sets an empty one, false and undefined none. */
  [attribute: string]: string | number | boolean | undefined | Listeners | Record<string, string>;
  on?: Listeners;
  /** Styles, by way of the CSSOM: the page's policy forbids style attributes. */
  css?: Record<string, string>;
}

function apply(element: Element & ElementCSSInlineStyle, props: Props, children: Child[]): void {
  const { on, css, ...attributes } = props;
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === undefined) continue;
    element.setAttribute(name, value === true ? "" : String(value));
  }
  for (const [name, value] of Object.entries(css ?? {})) element.style.setProperty(name, value);
  for (const [name, listener] of Object.entries(on ?? {})) {
    element.addEventListener(name, listener as EventListener);
  }
  element.append(...children.filter((child): child is Node | string => !!child));
}

/** Return an element with attributes, listeners and children; strings become text nodes. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  apply(element, props, children);
  return element;
}

/** Return an element of SVG. */
export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): SVGElementTagNameMap[K] {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  apply(element, props, children);
  return element;
}

/** Return a list to choose from, with its label. */
export function choice(
  label: string,
  options: readonly (readonly [value: string, text: string])[],
  change: (value: string) => void,
  selected?: string,
): { label: HTMLLabelElement; select: HTMLSelectElement } {
  const select = h(
    "select",
    { on: { change: () => change(select.value) } },
    ...options.map(([value, text]) => h("option", { value, selected: value === selected }, text)),
  );
  return { label: h("label", { class: "choice" }, h("span", {}, label), select), select };
}

/** Return a tick box with its label. */
export function tick(label: string, on: boolean, change: (on: boolean) => void): HTMLLabelElement {
  const input = h("input", {
    type: "checkbox",
    checked: on,
    on: { change: () => change(input.checked) },
  });
  return h("label", { class: "tick" }, input, label);
}

/** Return a section with a heading and what it says in a sentence. */
export function section(
  id: string,
  title: string,
  lead: Child,
  ...children: Child[]
): HTMLElement {
  return h(
    "section",
    { id, "aria-labelledby": `${id}-title` },
    h("h2", { id: `${id}-title` }, title),
    lead && h("p", { class: "lead" }, lead),
    ...children,
  );
}

/** Return a table in a region that scrolls by itself. */
export function table(
  caption: string,
  head: Child[],
  rows: HTMLTableRowElement[],
  className = "",
): HTMLElement {
  return h(
    "div",
    { class: "scroll", role: "region", "aria-label": caption, tabindex: 0 },
    h(
      "table",
      { class: className },
      h("caption", {}, caption),
      h("thead", {}, h("tr", {}, ...head.map((cell) => h("th", { scope: "col" }, cell)))),
      h("tbody", {}, ...rows),
    ),
  );
}

/** Resize a canvas to its box, in real pixels; return its context in CSS pixels and its size. */
export function fit(canvas: HTMLCanvasElement): [CanvasRenderingContext2D, number, number] | null {
  const { clientWidth: width, clientHeight: height } = canvas;
  const context = canvas.getContext("2d");
  if (!context || !width || !height) return null;
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}
