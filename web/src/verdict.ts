/** The verdict in words: what it is, why, what to do next, and what was corrected. */
import { h, section, svg, table, type Child } from "./dom";
import { explain } from "./explain";
import { figure, format, term, type Path } from "./number";
import type { Recording } from "./recording";
import type { Check, Run, RunCamera } from "./run";

const WORDS: Record<string, { tone: string; title: string; text: string }> = {
  "well determined": {
    tone: "good",
    title: "Well determined",
    text: "You can use this calibration. The recording determines every camera, and all checks passed.",
  },
  usable: {
    tone: "fair",
    title: "Usable",
    text: "You can use this calibration with care: for angles of joints it may be too little. Read the reasons below.",
  },
  weak: {
    tone: "poor",
    title: "Weak",
    text: "Check this calibration against something you know, a length or a place, before you use it.",
  },
  "not determined": {
    tone: "bad",
    title: "Not determined",
    text: "Do not measure with this calibration. The reasons below state what to record instead.",
  },
};

// a shape for each verdict: colour alone must not tell
const MARKS: Record<string, string> = {
  good: "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zm-1.6 14.6-4.4-4.4 1.7-1.7 2.7 2.7 5.9-5.9 1.7 1.7z",
  fair: "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zm-5 8.8h10v2.4H7z",
  poor: "M12 2 1 21h22zm-1.2 6.5h2.4v6h-2.4zm0 7.7h2.4v2.4h-2.4z",
  bad: "M8 2 2 8v8l6 6h8l6-6V8l-6-6zm.6 4.9L12 10.3l3.4-3.4 1.7 1.7-3.4 3.4 3.4 3.4-1.7 1.7-3.4-3.4-3.4 3.4-1.7-1.7 3.4-3.4-3.4-3.4z",
};

/** Return the mark of a tone. */
export function mark(tone: string): SVGElement {
  return svg(
    "svg",
    { viewBox: "0 0 24 24", class: `mark ${tone}`, "aria-hidden": "true", focusable: "false" },
    svg("path", { d: MARKS[tone]!, "fill-rule": "evenodd" }),
  );
}

export function toneOf(verdict: string): string {
  return (WORDS[verdict] ?? WORDS["not determined"]!).tone;
}

function tile(path: Path, label: string, unit = "", note: Child = null): HTMLElement {
  return h(
    "div",
    { class: "tile" },
    h("dt", {}, label),
    h("dd", {}, figure(path, { unit, name: label }), note && h("small", {}, note)),
  );
}

function tiles(run: Run): HTMLElement {
  return h(
    "dl",
    { class: "tiles" },
    tile(["verdict", "rotation_sigma_deg", "max"], "Rotation uncertainty", "°", "worst camera, one standard deviation"),
    tile(["verdict", "centre_sigma_percent", "max"], "Uncertainty of the centre", " %", "worst camera, of the size of the rig"),
    tile(["points", "reprojection_error_px", "median"], "Reprojection error", " px", "median of all points"),
    tile(["frames", "count"], "Frames", "", h("span", {}, "of two cameras or more")),
    h("div", { class: "tile" }, h("dt", {}, "Cameras"), h("dd", {}, h("span", { class: "plain" }, String(run.cameras.length)), run.left_out.length ? h("small", { class: "warn" }, `${run.left_out.length} left out`) : h("small", {}, "all in the rig"))),
    h("div", { class: "tile" }, h("dt", {}, "Individuals"), h("dd", {}, h("span", { class: "plain" }, String(run.individuals.length)), h("small", {}, `model: ${run.model}`))),
  );
}

function faultRow(run: Run, camera: RunCamera, word: string): HTMLElement {
  const view = run.cameras.indexOf(camera);
  const evidence = camera.fault_evidence[word] ?? {};
  const says = typeof evidence.says === "string" ? evidence.says : word;
  const numbers = Object.keys(evidence).filter((key) => typeof evidence[key] === "number");
  return h(
    "li",
    { class: evidence.mended ? "fault mended" : "fault" },
    h("div", {}, h("strong", {}, camera.name), " ", h("span", { class: "chip" }, word), " ",
      h("span", { class: evidence.mended ? "chip good" : "chip poor" }, evidence.mended ? "corrected for this run" : "not corrected")),
    h("p", { class: "why" }, says),
    typeof evidence.advice === "string" ? h("p", { class: "do" }, evidence.advice) : null,
    typeof evidence.option === "string" ? h("p", { class: "option" }, "State it beforehand: ", h("code", {}, evidence.option)) : null,
    numbers.length
      ? h("p", { class: "evidence" }, "Evidence: ", ...numbers.flatMap((key, i) => [
          `${i ? " · " : ""}${key.replaceAll("_", " ")} `, figure(["cameras", view, "fault_evidence", word, key], { name: key })]))
      : null,
  );
}

function faults(run: Run): Child {
  const rows = run.cameras.flatMap((camera) => camera.faults.map((word) => faultRow(run, camera, word)));
  for (const name of run.left_out) {
    rows.push(h("li", { class: "fault" }, h("div", {}, h("strong", {}, name), " ", h("span", { class: "chip poor" }, "left out")),
      h("p", { class: "why" }, "No other camera confirms what it sees.")));
  }
  if (!rows.length) return h("p", { class: "none" }, "No fault was found in the files.");
  return h("ul", { class: "faults" }, ...rows);
}

/** Return a bar: where the value is, where sound recordings are, and where the limit is. */
function gauge(check: Check, sound: [number, number]): Child {
  const value = check.value;
  const low = Math.min(0, sound[0], value ?? 0, check.limit);
  const high = Math.max(check.limit, sound[1], Math.min(value ?? 0, 3 * Math.abs(check.limit) || 1)) * 1.15 || 1;
  const at = (x: number): number => Math.max(0, Math.min(100, (100 * (x - low)) / (high - low)));
  const band = Math.max(1.5, at(sound[1]) - at(sound[0]));
  return svg(
    "svg",
    { class: "gauge", viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" },
    svg("rect", { class: "rail", x: 0, y: 3.5, width: 100, height: 3 }),
    svg("rect", { class: "band", x: at(sound[0]), y: 2, width: band, height: 6 }),
    svg("rect", { class: "limit", x: at(check.limit) - 0.3, y: 0, width: 0.6, height: 10 }),
    value === null ? null : svg("rect", { class: check.passed ? "value good" : "value bad", x: at(value) - 0.9, y: 0, width: 1.8, height: 10 }),
  );
}

function checkRow(check: Check, index: number, about?: { text: string; sound: [number, number] }): HTMLTableRowElement {
  const known = check.value !== null;
  const tone = !known ? "none" : check.passed ? "good" : "bad";
  const sound = about ? about.sound.map(format).join(" to ") : "";
  const explanation = about ? { label: check.name, text: about.text, sound: `${sound}; limit ${format(check.limit)}` } : null;
  return h(
    "tr",
    { class: tone },
    h("th", { scope: "row" }, term(check.name, explanation)),
    h("td", {}, h("span", { class: `state ${tone}` }, known ? (check.passed ? "✓ passed" : "✕ failed") : "– nothing to look at")),
    h("td", { class: "n" }, figure(["verdict", "checks", index, "value"], { quiet: true })),
    h("td", { class: "wide" }, gauge(check, about?.sound ?? [0, check.limit])),
    h("td", { class: "n" }, sound === "0 to 0" ? "0" : sound),
    h("td", { class: "n" }, figure(["verdict", "checks", index, "limit"], { quiet: true })),
    h("td", {}, check.camera ?? "all"),
  );
}

function checks({ run, checks: abouts }: Recording): HTMLElement {
  const list = run.verdict.checks;
  const unknown = list.filter((check) => check.value === null).length;
  const failed = list.filter((check) => check.value !== null && !check.passed).length;
  const open = failed > 0;
  const heads = ["Check", "State", term("Found", explain(["verdict", "checks", 0, "value"])), "Found, sound range, limit", "Sound recordings",
    term("Limit", explain(["verdict", "checks", 0, "limit"])), "Camera"];
  return h(
    "details",
    { open, class: "checks" },
    h("summary", {}, failed ? `${failed} of ${list.length} checks failed` : unknown ? `${list.length - unknown} of ${list.length} checks passed, ${unknown} not known` : `All ${list.length} checks passed`),
    table("Checks that look for what the uncertainty does not cover", heads, list.map((check, i) => checkRow(check, i, abouts[check.name]))),
  );
}

/** Return the first section. */
export function verdictSection(recording: Recording): HTMLElement {
  const { run } = recording;
  const word = WORDS[run.verdict.rig] ?? WORDS["not determined"]!;
  const { reasons } = run.verdict;
  return section(
    "verdict",
    "Verdict",
    null,
    h(
      "div",
      { class: `verdict ${word.tone}` },
      mark(word.tone),
      h("div", {}, h("p", { class: "word" }, word.title), h("p", { class: "says" }, word.text)),
    ),
    reasons.length
      ? h("div", { class: "reasons" }, h("h3", {}, "Why, and what to do next"), h("ul", {}, ...reasons.map((reason) => h("li", {}, reason))))
      : null,
    tiles(run),
    h("h3", {}, "What was wrong with the files"),
    faults(run),
    checks(recording),
  );
}
