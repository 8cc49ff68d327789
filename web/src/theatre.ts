/** The rig and its bodies in 3D, and beside it what one camera saw. */
import { choice, h, section, tick } from "./dom";
import { Look } from "./look";
import type { Player } from "./player";
import type { Recording } from "./recording";
import { openFaults } from "./run";
import { Stage, type StageOptions } from "./stage";
import { transport } from "./transport";

const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

function stageBar(stage: Stage, recording: Recording, player: Player): HTMLElement {
  const set = (name: keyof StageOptions) => (on: boolean): void => {
    stage.options[name] = on;
    stage.refresh();
  };
  const factor = choice("Ellipsoids", [["0", "hidden"] as const, ...FACTORS.map((each) => [String(each), each === 1 ? "1 σ" : `1 σ, ${each} × larger`] as const)], (value) => {
    stage.options.ellipsoids = value !== "0";
    if (value !== "0") stage.rig.exaggeration = Number(value);
    stage.refresh();
  }, String(stage.rig.exaggeration));
  const home = h("button", { type: "button", on: { click: () => { player.choose("follow", -1); stage.frameAll(); } } }, "Whole rig");
  return h("div", { class: "bar" },
    tick("Names", true, set("names")),
    tick("Trails", true, set("trails")),
    recording.reference ? tick("Reference rig", true, set("reference")) : null,
    factor.label,
    home);
}

/** Return words in place of the 3D view where the browser cannot draw it. */
function withoutWebGL(recording: Recording): HTMLElement {
  return h("div", { class: "stage static", role: "note" },
    h("p", {}, h("strong", {}, "The 3D view needs WebGL, which this browser does not have or does not allow.")),
    h("p", {}, `The rig has ${recording.cameras.length} cameras and ${recording.individuals.length} individuals. `
      + "The image of each camera, the numbers and all other parts of this page work without it."));
}

function note(recording: Recording): string {
  const { run } = recording;
  const lengths = run.unit === "arbitrary" ? "Lengths are arbitrary: no known length was stated." : `Lengths are in ${run.unit}.`;
  const floor = recording.floor ? "The grid is the floor." : "No floor is known, so there is no grid.";
  const left = run.left_out.length ? ` Not in the rig: ${run.left_out.join(", ")}.` : "";
  const doubtful = run.cameras.some((camera) => camera.weak || openFaults(camera).length) ? " Red cameras are weak, or have a fault that was not corrected." : "";
  const shapes = recording.covarianceKind === "axes" ? "" : " The ellipsoids are spheres: files of results say how far a camera may be off, not in which direction.";
  return `${lengths} ${floor}${doubtful}${shapes}${left}`;
}

/** Return the second section, and start the views. */
export function theatre(recording: Recording, player: Player): HTMLElement {
  const look = new Look(recording, player);
  let view: HTMLElement;
  let bar: HTMLElement | null = null;
  try {
    const stage = new Stage(recording, player);
    view = stage.host;
    bar = stageBar(stage, recording, player);
  } catch {
    view = withoutWebGL(recording);
  }
  return section(
    "rig",
    "The rig and what it saw",
    "Drag to turn the rig; click a camera to look through it. The coloured body is what its detector found, the thin one is the 3D body put back into the image: where they lie on each other, the camera is where the rig says.",
    h("div", { class: "theatre" },
      h("div", { class: "panel" }, bar, view, h("p", { class: "small" }, note(recording))),
      h("div", { class: "panel" }, look.element)),
    transport(recording, player),
    h("p", { class: "small" }, "Keys: space plays, ← and → step a frame. In the 3D view, Shift with arrow keys turns, + and − zoom; after a click the wheel zooms, too."),
  );
}
