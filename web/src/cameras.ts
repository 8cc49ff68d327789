/** Each camera: its numbers, and how the rig fits what it saw. */
import { Chart, values } from "./charts";
import { choice, fit, h, section, svg, table, type Child } from "./dom";
import { explain } from "./explain";
import { short } from "./labels";
import { figure, format, term, type Path } from "./number";
import { mix } from "./palette";
import type { Player } from "./player";
import { median, type Fits, type Recording } from "./recording";
import { openFaults } from "./run";
import { colour, onTheme } from "./theme";

/** So many joints a cell has at least, where its mean error is shown. */
const FEW = 10;

/** Draw where in the image of a camera joints were seen, and by what the 3D points miss them. */
function drawCoverage(canvas: HTMLCanvasElement, recording: Recording, view: number, arrows: boolean): number {
  const fitted = fit(canvas);
  const { fits } = recording;
  if (!fitted || !fits) return 0;
  const [context, width, height] = fitted;
  const { columns, rows, counts } = fits;
  const [w, hgt] = [width / columns, height / rows];
  const first = view * columns * rows;
  const most = Math.max(1, ...Array.from({ length: columns * rows }, (_, i) => counts[first + i]!));
  const [from, to] = [colour("image"), colour("heat")];
  context.fillStyle = from;
  context.fillRect(0, 0, width, height);
  for (let i = 0; i < columns * rows; i++) {
    const count = counts[first + i]!;
    if (!count) continue;
    context.fillStyle = mix(from, to, 0.12 + 0.78 * Math.sqrt(count / most));
    context.fillRect((i % columns) * w, Math.floor(i / columns) * hgt, w + 0.5, hgt + 0.5);
  }
  return arrows ? drawResiduals(context, fits, first, w, hgt) : 0;
}

/** Draw the mean errors as arrows; return by how many times they are longer than they are. */
function drawResiduals(context: CanvasRenderingContext2D, fits: Fits, first: number, w: number, hgt: number): number {
  const { columns, rows, residuals, counts } = fits;
  const lengths: number[] = [];
  // the mean of a few joints is chance
  const enough = (cell: number): boolean => counts[cell]! >= FEW && residuals[2 * cell] === residuals[2 * cell];
  for (let cell = first; cell < first + columns * rows; cell++) {
    if (enough(cell)) lengths.push(Math.hypot(residuals[2 * cell]!, residuals[2 * cell + 1]!));
  }
  if (!lengths.length) return 0;
  lengths.sort((a, b) => a - b);
  const usual = lengths[Math.floor(0.8 * lengths.length)]! || 1;
  const factor = Math.min(w, hgt) / usual;
  context.strokeStyle = context.fillStyle = colour("ink");
  context.lineWidth = 1.2;
  for (let i = 0; i < columns * rows; i++) {
    if (!enough(first + i)) continue;
    const at = 2 * (first + i);
    let [dx, dy] = [residuals[at]! * factor, residuals[at + 1]! * factor];
    const length = Math.hypot(dx, dy);
    const most = 2 * Math.min(w, hgt);
    if (length > most) [dx, dy] = [(dx * most) / length, (dy * most) / length];
    const [x, y] = [((i % columns) + 0.5) * w, (Math.floor(i / columns) + 0.5) * hgt];
    const angle = Math.atan2(dy, dx);
    const head = Math.min(4, 0.5 * Math.hypot(dx, dy));
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + dx, y + dy);
    for (const side of [-0.5, 0.5]) {
      context.moveTo(x + dx, y + dy);
      context.lineTo(x + dx - head * Math.cos(angle + side), y + dy - head * Math.sin(angle + side));
    }
    context.stroke();
  }
  return factor;
}

/** Return bars: the median error of each joint. */
function jointBars(recording: Recording, view: number): HTMLElement {
  const { fits, joints, sides } = recording;
  const errors = joints.map((_, joint) => fits!.byJoint[view * joints.length + joint]!);
  const known = errors.filter(Number.isFinite);
  // one joint that is far off must not hide the others
  const most = Math.min(Math.max(...known, 1e-9), 5 * median(known) || 1);
  const rows = joints.map((name, joint) => {
    const error = errors[joint]!;
    const width = Number.isFinite(error) ? Math.max(1, Math.min(100, (100 * error) / most)) : 0;
    return h("tr", {},
      h("th", { scope: "row" }, name),
      h("td", { class: "wide" }, svg("svg", { class: `bars ${sides[joint]}`, viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" },
        svg("rect", { x: 0, y: 1, width, height: 8 }))),
      h("td", { class: error > most ? "n warn" : "n" }, Number.isFinite(error) ? `${error.toFixed(1)} px` : "never"));
  });
  return table("Median error of each joint", ["Joint", "Bar", "Error"], rows, "tight");
}

function pair(label: string, ...content: Child[]): HTMLElement {
  return h("div", {}, h("dt", {}, label), h("dd", {}, ...content));
}

/** Return what is known of a camera beside the table: clock, lens, evidence. */
function facts(recording: Recording, camera: number): HTMLElement {
  const { run } = recording;
  const about = run.cameras[camera]!;
  const at = (...path: Path): Path => ["cameras", camera, ...path];
  const clock = run.clocks.findIndex((each) => each.camera === about.name);
  const kind = run.clocks[clock];
  return h("dl", { class: "facts" },
    kind ? pair("Clock", `${kind.kind}${kind.applied ? ", put right for this run" : ""}: `, figure(["clocks", clock, "offset_frames"], { unit: " frames" }),
      ", rate ", figure(["clocks", clock, "rate"])) : null,
    pair("Part of a frame", figure(at("clock", "subframe_offset")), " ± ", figure(at("clock", "sigma")), about.clock.used ? " (used)" : " (not used)"),
    pair("Focal length", figure(at("intrinsics", "focal_px"), { unit: " px" }), ` ${about.intrinsics.source}`,
      ...(run.cameras[camera]!.intrinsics.source === "given"
        ? ["; free, it would change by ", figure(at("intrinsics", "focal_change"), { unit: " %", scale: 100 }), " ± ", figure(at("intrinsics", "focal_change_sigma"), { unit: " %", scale: 100 })]
        : [" ± ", figure(at("intrinsics", "focal_sigma_px"), { unit: " px" })])),
    pair("Lens k1", figure(at("intrinsics", "k1"))),
    pair("Intrinsics' part of the turn", figure(at("intrinsics_turn_deg"), { unit: "°" })),
    pair("Shift as a length", figure(at("centre_sigma"), { unit: run.unit === "arbitrary" ? "" : ` ${run.unit}` })),
    about.weak_perspective ? pair("Perspective", "weak: its distance follows from its focal length alone") : null);
}

class Detail {
  readonly element = h("div", { class: "detail" });
  private readonly canvas = h("canvas", { class: "coverage", role: "img" });
  private readonly key = h("figcaption", {});
  private readonly chart: Chart;
  private readonly select: HTMLSelectElement;
  private readonly title = h("h3", {});
  private readonly curve = h("h4", {});
  private readonly joints = h("div", { class: "joints" });
  private readonly known = h("div", {});

  constructor(private readonly recording: Recording, private readonly player: Player) {
    this.chart = new Chart(player);
    const { cameras, fits } = recording;
    const list = choice("Camera", cameras.map((camera, view) => [String(view), short(camera.name, 28)] as const), (value) => player.choose("camera", Number(value)));
    this.select = list.select;
    this.element.append(h("div", { class: "bar" }, this.title, list.label), this.known);
    if (fits) {
      this.element.append(h("div", { class: "columns" },
        h("figure", {}, h("h4", {}, "Where in the image, and by what it is missed"), this.canvas, this.key),
        h("div", { class: "time" }, this.curve, this.chart.element),
        this.joints));
    }
    player.on((change) => change === "camera" && this.show());
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.show();
  }

  private show(): void {
    const { recording, player } = this;
    const view = player.camera;
    const camera = recording.cameras[view];
    if (!camera) return;
    this.select.value = String(view);
    this.title.textContent = camera.name;
    this.known.replaceChildren(facts(recording, camera.camera));
    const { fits } = recording;
    if (!fits) return;
    this.joints.replaceChildren(jointBars(recording, view));
    const [n, at] = [fits.bins.length, view * fits.bins.length];
    const high = Array.from(fits.p95.slice(at, at + n)).filter(Number.isFinite);
    const top = 4 * median(high);
    const cut = Math.max(...high) > top;
    this.curve.textContent = cut ? "Error over time (px; peaks are cut)" : "Error over time (px)";
    this.chart.show({
      ...(cut ? { top } : {}),
      title: `Reprojection error of ${camera.name} over time, median and 95th percentile`,
      frames: fits.bins, unit: " px",
      curves: [
        { label: "median", colour: () => colour("accent"), values: values(fits.median, at, at + n), width: 2 },
        { label: "95 %", colour: () => colour("muted"), values: values(fits.p95, at, at + n), dash: [4, 3] },
      ],
    });
    this.draw();
  }

  private draw(): void {
    const { recording } = this;
    const camera = recording.cameras[this.player.camera];
    if (!camera || !recording.fits) return;
    if (camera.size[0]) this.canvas.style.setProperty("aspect-ratio", `${camera.size[0]} / ${camera.size[1]}`);
    const factor = drawCoverage(this.canvas, recording, this.player.camera, true);
    const { columns, rows, counts } = recording.fits;
    const first = this.player.camera * columns * rows;
    const seen = Array.from({ length: columns * rows }, (_, i) => counts[first + i]!).filter(Boolean).length;
    const text = `Joints were seen in ${Math.round((100 * seen) / (columns * rows))} % of the image; the darker, the more.`
      + (factor ? ` Arrows: mean error, ${format(Number(factor.toPrecision(2)))} times as long as it is.` : "");
    this.key.textContent = text;
    this.canvas.setAttribute("aria-label", `Coverage of the image of ${camera.name}. ${text}`);
  }
}

const COLUMNS: [path: Path, label: string, unit: string][] = [
  [["rotation_sigma_deg"], "Rotation ±", "°"],
  [["centre_sigma_percent"], "Centre ±", " %"],
  [["reprojection_error_px", "median"], "Error", " px"],
  [["reprojection_error_px", "p95"], "95 %", " px"],
  [["pair_score"], "Pair score", ""],
  [["detections"], "Detections", ""],
  [["matched"], "Matched", ""],
  [["unmatched"], "Unmatched", ""],
];

function row(recording: Recording, player: Player, camera: number, redraw: (() => void)[]): HTMLTableRowElement {
  const { run, cameras } = recording;
  const about = run.cameras[camera]!;
  const view = cameras.findIndex((each) => each.camera === camera);
  const thumb = h("canvas", { class: "thumb", "aria-hidden": "true" });
  const size = cameras[view]?.size;
  if (size?.[0]) thumb.style.setProperty("aspect-ratio", `${size[0]} / ${size[1]}`);
  redraw.push(() => drawCoverage(thumb, recording, view, false));
  const open = openFaults(about);
  const words = [...about.faults, ...(about.weak ? ["weak"] : [])];
  const chips = words.map((word) => {
    const mended = about.faults.includes(word) && !open.includes(word);
    return h("span", { class: mended ? "chip good" : "chip poor" }, mended ? `${word}, corrected` : word);
  });
  const clock = run.clocks.findIndex((each) => each.camera === about.name);
  const button = h("button", { type: "button", class: "link", on: { click: () => player.choose("camera", view) } }, short(about.name, 30));
  if (about.name.length > 30) button.title = about.name;
  const element = h("tr", {},
    h("th", { scope: "row" }, button),
    recording.fits ? h("td", {}, thumb) : null,
    ...COLUMNS.map(([path, , unit]) => h("td", { class: "n" }, figure(["cameras", camera, ...path], { quiet: true, unit }))),
    h("td", { class: "n" }, clock < 0 ? "–" : figure(["clocks", clock, "offset_frames"], { quiet: true })),
    h("td", {}, ...(chips.length ? chips : ["none"])));
  const mark = (): void => {
    const chosen = cameras[player.camera]?.camera === camera;
    element.classList.toggle("chosen", chosen);
    button.setAttribute("aria-pressed", String(chosen));
  };
  player.on((change) => change === "camera" && mark());
  mark();
  return element;
}

/** Return the fourth section. */
export function camerasSection(recording: Recording, player: Player): HTMLElement {
  const { run, fits } = recording;
  const redraw: (() => void)[] = [];
  const rows = run.cameras.map((_, camera) => row(recording, player, camera, redraw));
  const heads = ["Camera", ...(fits ? ["Coverage"] : []),
    ...COLUMNS.map(([path, label]) => term(label, explain(["cameras", 0, ...path]))), term("Clock", explain(["clocks", 0, "offset_frames"])), "Faults"];
  const list = table("All cameras", heads, rows, "list");
  const drawAll = (): void => redraw.forEach((draw) => draw());
  onTheme(drawAll);
  new ResizeObserver(drawAll).observe(list);
  return section("cameras", "Camera by camera",
    "Standard deviations: a camera is rarely off by more than twice of it. Choose a camera to see where in its image bodies were, and by what they are missed.",
    list, new Detail(recording, player).element);
}
