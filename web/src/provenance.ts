/** What the results were made of: files, settings, versions; and all of run.json. */
import { h, section, table } from "./dom";
import { explain } from "./explain";
import { figure, lookUp, term, type Path } from "./number";
import type { Recording } from "./recording";
import type { Json } from "./run";

function hashes(caption: string, part: "inputs" | "outputs", all: Record<string, string> | undefined): HTMLElement | null {
  const names = Object.keys(all ?? {});
  if (!names.length) return null;
  return h("details", {}, h("summary", {}, `${caption} (${names.length})`),
    table(caption, ["File", term("SHA-256", explain([part, ""]))],
      names.map((name) => h("tr", {}, h("th", { scope: "row" }, name), h("td", { class: "hash" }, figure([part, name], { quiet: true })))), "tight"));
}

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
    line("Date", run.date ?? "not known"),
    line("Model", run.model, run.solver ? `, pairs by ${run.solver}` : ""),
    line("Seed", figure(["seed"])),
    line("Unit of lengths", run.unit),
    line("World", run.world.kind, run.world.camera ? ` (${run.world.camera})` : ""),
    line("Frames", figure(["frames", "first"]), " to ", figure(["frames", "last"]), ", ", figure(["frames", "count"]), " in all"),
    line("3D points", figure(["points", "triangulated"]), ", error ", figure(["points", "reprojection_error_px", "median"], { unit: " px" }), ", 95 % below ", figure(["points", "reprojection_error_px", "p95"], { unit: " px" })),
    line("Joints made of", "two views or more ", figure(["poses", "triangulated"]), ", one view ", figure(["poses", "one_view"]), ", interpolated ", figure(["poses", "interpolated"]), ", dropped detections ", figure(["poses", "outliers"])),
    ...(lookUp(["fingerprint"]) ? [line("Fingerprint", h("span", { class: "hash" }, figure(["fingerprint"])))] : []));
}

/** Return the last section. */
export function provenanceSection(recording: Recording): HTMLElement {
  const { run, notes } = recording;
  const seconds = Object.keys(run.seconds ?? {});
  return section("provenance", "Where this comes from", null,
    facts(recording),
    run.world.remarks.length ? h("ul", { class: "small" }, ...run.world.remarks.map((remark) => h("li", {}, remark))) : null,
    notes.length ? h("ul", { class: "notes" }, ...notes.map((note) => h("li", {}, note))) : null,
    hashes("Files that were read", "inputs", run.inputs),
    hashes("Files of results", "outputs", run.outputs),
    seconds.length ? h("details", {}, h("summary", {}, "Time taken"),
      table("Wall time of each stage in seconds", ["Stage", term("Seconds", explain(["seconds", ""]))],
        seconds.map((name) => h("tr", {}, h("th", { scope: "row" }, name), h("td", { class: "n" }, figure(["seconds", name], { quiet: true })))), "tight")) : null,
    h("details", { class: "tree" }, h("summary", {}, "Configuration"), h("ul", {}, ...Object.keys(run.config).map((name) => tree(name, ["config", name])))),
    h("details", { class: "tree" }, h("summary", {}, "All of run.json"), h("ul", {}, ...Object.keys(run).map((name) => tree(name, [name])))));
}
