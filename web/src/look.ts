/** What the chosen camera saw, and where the 3D bodies are in its image, over each other. */
import { project } from "./camera_model";
import type { RigCamera } from "./data";
import { choice, fit, h } from "./dom";
import { short, widthOf } from "./labels";
import { ofIndividual } from "./palette";
import type { Player } from "./player";
import { offsetOf, type Recording } from "./recording";
import { standsAt } from "./rig_model";
import { colour, onTheme } from "./theme";

const CROWD = 12;

type Box = [number, number, number, number];

export class Look {
  private readonly canvas = h("canvas", { class: "look", role: "img" });
  private readonly select: HTMLSelectElement;
  private readonly says = h("p", { class: "says", "aria-live": "off" });
  readonly element: HTMLElement;
  private close = false;
  private box: Box | null = null;
  private context!: CanvasRenderingContext2D;
  private scale = 1;
  private origin: [number, number] = [0, 0];

  constructor(private readonly recording: Recording, private readonly player: Player) {
    const names = recording.cameras.map((camera, view) => [String(view), short(camera.name, 28)] as const);
    const list = choice("Look through", names, (value) => player.choose("camera", Number(value)));
    this.select = list.select;
    const zoom = choice("Show", [["all", "the whole image"], ["near", "the bodies, near"]], (value) => {
      this.close = value === "near";
      this.box = null;
      this.draw();
    });
    this.element = h(
      "figure",
      { class: "looking" },
      h("div", { class: "bar" }, list.label, zoom.label),
      this.canvas,
      h("figcaption", {}, legend(), this.says),
    );
    player.on((change) => {
      if (change === "camera") {
        this.box = null;
        this.select.value = String(player.camera);
      }
      if (change !== "playing") this.draw();
    });
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  draw(): void {
    const camera = this.recording.cameras[this.player.camera];
    if (!camera) return;
    const [width, height] = camera.size[0] ? camera.size : [2 * camera.matrix[2]!, 2 * camera.matrix[5]!];
    this.canvas.style.setProperty("aspect-ratio", `${width} / ${height}`);
    const fitted = fit(this.canvas);
    if (!fitted) return;
    const [context, w, hgt] = fitted;
    this.context = context;
    const box = (this.close && this.nearBox()) || [0, 0, width, height];
    this.scale = Math.min(w / (box[2] - box[0]), hgt / (box[3] - box[1]));
    this.origin = [(w - this.scale * (box[0] + box[2])) / 2, (hgt - this.scale * (box[1] + box[3])) / 2];
    context.fillStyle = colour("image");
    context.fillRect(...this.at(0, 0), width * this.scale, height * this.scale);
    const seen = this.drawDetections();
    const shown = this.drawReprojections();
    this.drawErrors(seen, shown);
    const error = medianError(seen, shown);
    this.says.textContent = this.inWords(camera, seen.size + this.nobody, shown.size, error);
    this.canvas.setAttribute("aria-label", `Image of camera ${camera.name}. ${this.says.textContent}`);
  }

  private nobody = 0;

  private inWords(camera: RigCamera, seen: number, shown: number, error: number): string {
    const frame = this.recording.frames[this.player.index]!;
    if (!standsAt(camera, frame)) return `Frame ${frame}: ${camera.name} stands there from frame ${camera.first} to ${camera.last}.`;
    if (!this.recording.detections) return `Frame ${frame}: the report was made without the detections.`;
    if (!this.recording.looked[this.player.index]) return `Frame ${frame}: its detections are not in this report, to keep it small.`;
    const apart = Number.isFinite(error) ? `, ${error.toFixed(1)} px apart (median)` : "";
    return `Frame ${frame}: ${seen} detected, ${shown} ${shown === 1 ? "body" : "bodies"} in 3D${apart}.`;
  }

  private at(x: number, y: number): [number, number] {
    return [x * this.scale + this.origin[0], y * this.scale + this.origin[1]];
  }

  /** Draw what was detected in this frame; return it by individual. */
  private drawDetections(): Map<number, Float32Array> {
    const detections = this.recording.detections?.[this.player.camera];
    const found = new Map<number, Float32Array>();
    this.nobody = 0;
    if (!detections) return found;
    const stride = 2 * this.recording.joints.length;
    const first = detections.starts[this.player.index]!;
    const end = detections.starts[this.player.index + 1]!;
    for (let row = first; row < end; row++) {
      const individual = detections.individuals[row]!;
      const points = detections.points.subarray(row * stride, (row + 1) * stride);
      if (individual >= 0) found.set(individual, points);
      else this.nobody++;
      const dim = this.player.follow >= 0 && individual !== this.player.follow;
      this.drawBody(points, individual < 0 ? colour("muted") : ofIndividual(individual), dim ? 0.25 : 0.55, 5, false);
    }
    return found;
  }

  /** Draw where the bodies in 3D are in the image. */
  private drawReprojections(): Map<number, Float32Array> {
    const { recording, player } = this;
    const camera = recording.cameras[player.camera]!;
    const shown = new Map<number, Float32Array>();
    if (!standsAt(camera, recording.frames[player.index]!)) return shown;
    recording.individuals.forEach((_, individual) => {
      const start = offsetOf(recording, individual, player.index);
      const points = new Float32Array(2 * recording.joints.length).fill(NaN);
      let any = false;
      for (let joint = 0; joint < recording.joints.length; joint++) {
        const i = start + 3 * joint;
        const [x, y, z] = [recording.points[i]!, recording.points[i + 1]!, recording.points[i + 2]!];
        const place = x === x ? project(camera, x, y, z) : null;
        if (!place) continue;
        points.set(place, 2 * joint);
        any = true;
      }
      if (!any) return;
      shown.set(individual, points);
      const dim = player.follow >= 0 && individual !== player.follow;
      this.drawBody(points, colour("ink"), dim ? 0.15 : 0.9, 1.4, true);
      this.drawNumber(points, individual);
    });
    return shown;
  }

  private drawBody(points: Float32Array, shade: string, alpha: number, width: number, dots: boolean): void {
    const { context } = this;
    context.globalAlpha = alpha;
    context.strokeStyle = context.fillStyle = shade;
    context.lineWidth = width;
    context.lineCap = "round";
    context.beginPath();
    for (const [a, b] of this.recording.edges) {
      const [x, y, u, v] = [points[2 * a]!, points[2 * a + 1]!, points[2 * b]!, points[2 * b + 1]!];
      if (x !== x || u !== u) continue;
      context.moveTo(...this.at(x, y));
      context.lineTo(...this.at(u, v));
    }
    context.stroke();
    // the joints of a crowd would hide each other, and take time
    const most = this.recording.individuals.length > CROWD ? 0 : points.length;
    context.beginPath();
    const radius = dots ? 1.8 : 4;
    for (let i = 0; i < most; i += 2) {
      if (points[i] !== points[i]) continue;
      const [x, y] = this.at(points[i]!, points[i + 1]!);
      context.moveTo(x + radius, y);
      context.arc(x, y, radius, 0, 7);
    }
    if (dots) context.fill();
    else {
      context.lineWidth = 1.6;
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  private drawNumber(points: Float32Array, individual: number): void {
    let [top, left] = [Infinity, 0];
    for (let i = 0; i < points.length; i += 2) {
      if (points[i + 1]! < top) [left, top] = [points[i]!, points[i + 1]!];
    }
    const { context } = this;
    const text = short(String(this.recording.individuals[individual]));
    const [x, y] = this.at(left, top);
    context.font = "600 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = ofIndividual(individual);
    context.beginPath();
    const width = widthOf(context, text) + 9;
    context.roundRect(x - width / 2, y - 22, width, 15, 7);
    context.fill();
    context.fillStyle = colour("paper");
    context.fillText(text, x, y - 14);
  }

  /** Draw a line from each detected joint to where the 3D body has it. */
  private drawErrors(seen: Map<number, Float32Array>, shown: Map<number, Float32Array>): void {
    const { context } = this;
    context.strokeStyle = colour("bad");
    context.lineWidth = 1.5;
    context.beginPath();
    for (const [individual, points] of seen) {
      const other = shown.get(individual);
      for (let i = 0; other && i < points.length; i += 2) {
        if (points[i] !== points[i] || other[i] !== other[i]) continue;
        context.moveTo(...this.at(points[i]!, points[i + 1]!));
        context.lineTo(...this.at(other[i]!, other[i + 1]!));
      }
    }
    context.stroke();
  }

  /** Return the part of the image that bodies are in; it moves only when they leave it. */
  private nearBox(): Box | null {
    const detections = this.recording.detections?.[this.player.camera];
    if (!detections) return null;
    const stride = 2 * this.recording.joints.length;
    const [first, end] = [detections.starts[this.player.index]!, detections.starts[this.player.index + 1]!];
    const now: Box = [Infinity, Infinity, -Infinity, -Infinity];
    for (let i = first * stride; i < end * stride; i += 2) {
      const [x, y] = [detections.points[i]!, detections.points[i + 1]!];
      if (x !== x) continue;
      [now[0], now[1]] = [Math.min(now[0], x), Math.min(now[1], y)];
      [now[2], now[3]] = [Math.max(now[2], x), Math.max(now[3], y)];
    }
    if (now[0] > now[2]) return this.box;
    const held = this.box;
    const leaves = !held || now[0] < held[0] || now[1] < held[1] || now[2] > held[2] || now[3] > held[3];
    if (leaves) {
      const margin = 0.25 * Math.max(now[2] - now[0], now[3] - now[1]) + 10;
      this.box = [now[0] - margin, now[1] - margin, now[2] + margin, now[3] + margin];
    }
    return this.box;
  }
}

function medianError(seen: Map<number, Float32Array>, shown: Map<number, Float32Array>): number {
  const errors: number[] = [];
  for (const [individual, points] of seen) {
    const other = shown.get(individual);
    for (let i = 0; other && i < points.length; i += 2) {
      const error = Math.hypot(points[i]! - other[i]!, points[i + 1]! - other[i + 1]!);
      if (error === error) errors.push(error);
    }
  }
  errors.sort((a, b) => a - b);
  return errors.length ? errors[errors.length >> 1]! : NaN;
}

function legend(): HTMLElement {
  const key = (name: string, text: string): HTMLElement => h("li", {}, h("span", { class: `key ${name}`, "aria-hidden": "true" }), text);
  return h("ul", { class: "legend" }, key("seen", "detected"), key("shown", "3D body, reprojected"), key("error", "error between"), key("nobody", "unmatched"));
}
