/** What the results were made of: settings and versions; and run.json. */
import { h, section } from "./dom";
import { figure, lookUp, type Path } from "./number";
import type { Recording } from "./recording";
import type { Json } from "./run";

/** Return a tree of values, made when it is opened: run.json may have thousands. */
function tree(name: string, path: Path): HTMLElement {
  const value = lookUp(path);
  if (value === null || typeof value !== "object") {
    return h("li", {}, h("span", { class: "key" }, name), " ", figure(path, { quiet: true }));
  }
  const entries: [string | number, Json][] = Array.isArray(value) ? value.map((each, i) => [i, each]) : Object.entries(value);
  if (!entries.length) return h("li", {}, h("span", { class: "key" }, name), " none");
  const list = h("ul", {});
  const details = h("details", { on: { toggle: () => list.children.length || list.append(...entries.map(([key]) => tree(String(key), [...path, key]))) } },
    h("summary", {}, h("span", { class: "key" }, name), h("span", { class: "count" }, ` ${entries.length}`)), list);
  return h("li", {}, details);
}

function facts(recording: Recording): HTMLElement {
  const { run } = recording;
  const line = (label: string, ...content: (Node | string)[]): HTMLElement => h("div", {}, h("dt", {}, label), h("dd", {}, ...content));
  return h("dl", { class: "facts" },
    line("Made by", `mocap-calib ${run.version}`),
    line("Date, times, files", "in run.json, with the SHA-256 of all files"),
    line("Model", run.model, run.solver ? `, pairs by ${run.solver}` : ""),
    line("Seed", figure(["seed"])),
    line("Unit of lengths", run.unit),
    line("World", run.world.kind, run.world.camera ? ` (${run.world.camera})` : ""),
    line("Frames", figure(["frames", "first"]), " to ", figure(["frames", "last"]), ", ", figure(["frames", "count"]), " in all"),
    line("3D points", figure(["points", "triangulated"]), ", error ", figure(["points", "reprojection_error_px", "median"], { unit: " px" }), ", 95 % below ", figure(["points", "reprojection_error_px", "p95"], { unit: " px" })),
    line("Joints made of", "two views or more ", figure(["poses", "triangulated"]), ", one view ", figure(["poses", "one_view"]), ", interpolated ", figure(["poses", "interpolated"]), ", dropped detections ", figure(["poses", "outliers"])));
}

/** Return the last section. */
export function provenanceSection(recording: Recording): HTMLElement {
  const { run, notes } = recording;
  return section("provenance", "Where this comes from", null,
    facts(recording),
    run.world.remarks.length ? h("ul", { class: "small" }, ...run.world.remarks.map((remark) => h("li", {}, remark))) : null,
    notes.length ? h("ul", { class: "notes" }, ...notes.map((note) => h("li", {}, note))) : null,
    h("details", { class: "tree" }, h("summary", {}, "Configuration"), h("ul", {}, ...Object.keys(run.config).map((name) => tree(name, ["config", name])))),
    h("details", { class: "tree" }, h("summary", {}, "run.json"), h("ul", {}, ...Object.keys(run).map((name) => tree(name, [name])))));
}
