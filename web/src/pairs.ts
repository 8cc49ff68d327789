/** Pairs of cameras and the loops they close, as a matrix. */
import { choice, h, section, type Child } from "./dom";
import { explain } from "./explain";
import { short } from "./labels";
import { figure, format, lookUp, term, type Path } from "./number";
import { mix, readable } from "./palette";
import type { Recording } from "./recording";
import { colour, onTheme } from "./theme";

interface Measure {
  path: Path;
  label: string;
  unit: string;
  /** Which values are dark: [pale, dark]. */
  range: (values: number[]) => [number, number];
  says: string;
}

const upTo = (values: number[]): [number, number] => [0, Math.max(...values, 1e-9)];
const MEASURES: Measure[] = [
  { path: ["score"], label: "Pair score", unit: "", range: () => [0, 1], says: "dark is good" },
  { path: ["reprojection_error_px", "median"], label: "Reprojection error", unit: " px", range: upTo, says: "dark is bad" },
  { path: ["loop_rotation_deg"], label: "Loop error, rotation", unit: "°", range: upTo, says: "dark is bad" },
  { path: ["loop_translation_deg"], label: "Loop error, direction", unit: "°", range: upTo, says: "dark is bad" },
  { path: ["rotation_sigma_deg"], label: "Rotation uncertainty", unit: "°", range: upTo, says: "dark is bad" },
  { path: ["epipolar_error_deg"], label: "Epipolar error", unit: "°", range: upTo, says: "dark is bad" },
  { path: ["matches"], label: "Matches", unit: "", range: upTo, says: "dark is many" },
  { path: ["baseline_body_sizes"], label: "Baseline", unit: " body sizes", range: upTo, says: "dark is far apart" },
  { path: ["weight"], label: "Weight", unit: "", range: () => [0, 1], says: "dark counts much" },
];
const SOURCES: Record<string, string> = { lifted: "the lifted bodies", "five-point": "five points of each", paper: "the solver of the paper" };
const MORE: Path[] = [["frames"], ["sampled_matches"], ["in_front"], ["reprojection_error_px", "p95"], ["epipolar_error_px"]];

/** Up to so many cameras a matrix has room for words. */
const MOST_WORDS = 12;

class Matrix {
  private measure = MEASURES[0]!;
  private readonly body = h("div", { class: "scroll", role: "region", tabindex: 0, "aria-label": "Pairs of cameras" });
  private readonly about = h("div", { class: "pair", "aria-live": "polite" });
  readonly element: HTMLElement;
  private readonly names: string[];
  private readonly indices = new Map<string, number>();

  constructor(private readonly recording: Recording) {
    const { run } = recording;
    // pairs name the views of a camera that was moved: all names that occur, in order
    const seen = new Set(recording.cameras.map((camera) => camera.name));
    run.pairs.forEach((pair, i) => {
      seen.add(pair.a).add(pair.b);
      this.indices.set(`${pair.a}\n${pair.b}`, i).set(`${pair.b}\n${pair.a}`, i);
    });
    this.names = [...seen];
    const list = choice("Show", MEASURES.map(({ label }, i) => [String(i), label] as const), (value) => {
      this.measure = MEASURES[Number(value)]!;
      this.draw();
    });
    this.element = h("div", {}, h("div", { class: "bar" }, list.label), h("div", { class: this.names.length <= MOST_WORDS ? "split pairs" : "pairs" }, this.body, this.about));
    onTheme(() => this.draw());
    this.draw();
    if (run.pairs.length) this.choose(0);
  }

  private draw(): void {
    const { measure, names } = this;
    const { run } = this.recording;
    const all = run.pairs.map((_, i) => Number(lookUp(["pairs", i, ...measure.path]) ?? NaN)).filter(Number.isFinite);
    const [low, high] = measure.range(all);
    const [from, to] = [colour("paper"), colour("heat")];
    const cell = (a: string, b: string): HTMLElement => {
      const index = this.indices.get(`${a}\n${b}`);
      if (a === b || index === undefined) return h("td", { class: a === b ? "self" : "unused" }, a === b ? "" : "·");
      const value = Number(lookUp(["pairs", index, ...measure.path]) ?? NaN);
      const share = Math.min(1, Math.max(0, (value - low) / (high - low || 1)));
      const pair = run.pairs[index]!;
      const depth = 0.06 + 0.84 * (share || 0);
      return h("td", { class: `n cell${pair.breaks_loop ? " breaks" : ""}`, css: { "background-color": mix(from, to, depth), color: readable(from, to, depth) },
        on: { click: () => this.choose(index) } }, figure(["pairs", index, ...measure.path], { quiet: true }));
    };
    const rows = names.slice(1).map((a, i) => h("tr", {}, h("th", { scope: "row", title: a }, short(a, 16)), ...names.slice(0, i + 1).map((b) => cell(a, b))));
    const few = names.length <= MOST_WORDS;
    this.body.replaceChildren(h("table", { class: few ? "matrix" : "matrix many" },
      h("caption", {}, term(measure.label, explain(["pairs", 0, ...measure.path])), ` of each pair of cameras; ${measure.says}. · is a pair that is not used`),
      h("tbody", {}, ...rows, h("tr", {}, h("td", {}), ...names.slice(0, -1).map((name) => h("th", { scope: "col", class: "foot", title: name }, h("span", {}, short(name, 16))))))));
  }

  /** Show all numbers of a pair. */
  private choose(index: number): void {
    const pair = this.recording.run.pairs[index]!;
    const list = this.recording.run.pairs.map((each, i) => [String(i), `${short(each.a, 18)} – ${short(each.b, 18)}`] as const);
    const chosen = choice("Pair", list, (value) => this.choose(Number(value)), String(index));
    const line = (path: Path, label: Child, unit = ""): HTMLElement => h("div", {}, h("dt", {}, label), h("dd", {}, figure(["pairs", index, ...path], { unit })));
    const hints = [
      pair.breaks_loop ? "It contradicts the others." : null,
      pair.alternatives.length ? `It had ${pair.alternatives.length} other answer${pair.alternatives.length > 1 ? "s" : ""}.` : null,
    ].filter(Boolean).join(" ");
    const held = this.about.contains(document.activeElement);
    this.about.replaceChildren(chosen.label,
      h("dl", { class: "facts" }, ...MEASURES.map(({ path, label, unit }) => line(path, label, unit)),
        ...MORE.map((path) => line(path, explain(["pairs", 0, ...path])?.label ?? path.join(" ")))),
      h("p", { class: pair.breaks_loop ? "small warn" : "small" }, `Found by ${SOURCES[pair.source] ?? pair.source}. ${hints}`));
    if (held) chosen.select.focus();
  }
}

/** Return the first part of the fifth section. */
export function pairsSection(recording: Recording): HTMLElement {
  const { run } = recording;
  const broken = run.pairs.filter((pair) => pair.breaks_loop);
  const lead = run.pairs.length
    ? `Each pair of cameras finds by itself how the two stand; loops of pairs must close. ${broken.length ? `${broken.length} of ${run.pairs.length} pairs contradict the rig (outlined).` : "No pair contradicts the rig."}`
    : "There is no pair of cameras.";
  const unused = run.unused_pairs.length
    ? h("details", {}, h("summary", {}, `${run.unused_pairs.length} pairs are not in one group`),
        h("ul", { class: "small" }, ...run.unused_pairs.map((pair, i) => h("li", {}, `${pair.a} – ${pair.b}: score `, figure(["unused_pairs", i, "score"], { quiet: true })))))
    : null;
  return section("pairs", "Pairs and loops", lead, run.pairs.length ? new Matrix(recording).element : null, unused);
}

/** Return a share in percent. */
export function percent(share: number): string {
  return Number.isFinite(share) ? `${format(Number((100 * share).toPrecision(2)))} %` : "–";
}
