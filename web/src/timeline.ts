/** Identities: when each camera saw each individual. */
import { niceStep } from "./charts";
import { fit, h, section, table, tick } from "./dom";
import { explain } from "./explain";
import { short } from "./labels";
import { figure, term } from "./number";
import { ofIndividual } from "./palette";
import type { Player } from "./player";
import type { Recording, Swap, Track } from "./recording";
import { colour, onTheme } from "./theme";

const LEFT = 150;
const FEW = 64;

interface Lane {
  individual: number;
  /** -1: all cameras of the individual together. */
  camera: number;
  top: number;
  height: number;
}

class Timeline {
  readonly canvas = h("canvas", { class: "timeline", role: "img" });
  private readonly head = h("div", { class: "playhead", "aria-hidden": "true" });
  private readonly box = h("div", { class: "lanes" }, this.canvas, this.head);
  readonly element = h("div", { class: "scroll tall", tabindex: 0, role: "region", "aria-label": "Timeline of individuals by camera" }, this.box);
  private lanes: Lane[] = [];
  private readonly first: number;
  private readonly span: number;
  private readonly byPlace = new Map<string, Track>();

  constructor(private readonly recording: Recording, private readonly player: Player, public byCamera: boolean) {
    const { frames, tracks, individuals, cameras } = recording;
    this.first = frames[0] ?? 0;
    this.span = Math.max(1, (frames.at(-1) ?? 0) - this.first + 1);
    for (const track of tracks) this.byPlace.set(`${track.individual} ${track.camera}`, track);
    this.canvas.setAttribute("aria-label", `Timeline: ${individuals.length} individuals in ${cameras.length} cameras. The table below has the same in numbers.`);
    this.canvas.addEventListener("click", (event) => {
      const x = event.offsetX - LEFT;
      if (x >= 0) player.seekFrame(this.first + (x / (this.canvas.clientWidth - LEFT)) * this.span);
      const lane = this.lanes.find((each) => event.offsetY >= each.top && event.offsetY < each.top + each.height);
      if (lane) player.choose(lane.camera >= 0 ? "camera" : "follow", lane.camera >= 0 ? lane.camera : lane.individual);
    });
    player.on((change) => change === "frame" && this.movePlayhead());
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.box);
    this.layOut();
  }

  layOut(): void {
    const { individuals, cameras } = this.recording;
    this.lanes = [];
    let top = 8;
    individuals.forEach((_, individual) => {
      this.lanes.push({ individual, camera: -1, top, height: 20 });
      top += 22;
      if (this.byCamera) {
        cameras.forEach((__, camera) => {
          this.lanes.push({ individual, camera, top, height: 12 });
          top += 14;
        });
      }
      top += this.byCamera ? 12 : 6;
    });
    this.box.style.setProperty("height", `${top + 22}px`);
    this.draw();
  }

  private x(frame: number): number {
    return LEFT + ((frame - this.first) / this.span) * (this.canvas.clientWidth - LEFT - 8);
  }

  private movePlayhead(): void {
    const frame = this.recording.frames[this.player.index] ?? 0;
    this.head.style.setProperty("transform", `translateX(${this.x(frame)}px)`);
  }

  draw(): void {
    const fitted = fit(this.canvas);
    if (!fitted) return;
    const [context, width, height] = fitted;
    context.textBaseline = "middle";
    for (const lane of this.lanes) {
      if (lane.camera < 0) this.drawTogether(context, lane);
      else this.drawOne(context, lane);
    }
    this.drawSwaps(context);
    this.drawAxis(context, width, height);
    this.movePlayhead();
  }

  private name(context: CanvasRenderingContext2D, lane: Lane, text: string, strong: boolean): void {
    context.font = `${strong ? "600 13px" : "11px"} system-ui, sans-serif`;
    context.fillStyle = colour(strong ? "ink" : "muted");
    context.textAlign = "right";
    context.fillText(short(text, 20), LEFT - 10, lane.top + lane.height / 2 + 0.5);
  }

  /** Draw how many cameras see an individual: the more, the darker. */
  private drawTogether(context: CanvasRenderingContext2D, lane: Lane): void {
    const { cameras, individuals } = this.recording;
    this.name(context, lane, `individual ${individuals[lane.individual]}`, true);
    context.fillStyle = colour("rail");
    context.fillRect(LEFT, lane.top, this.x(this.first + this.span) - LEFT, lane.height);
    const columns = Math.max(1, Math.round(this.canvas.clientWidth - LEFT - 8));
    const seen = new Uint16Array(columns + 1);
    for (let camera = 0; camera < cameras.length; camera++) {
      const track = this.byPlace.get(`${lane.individual} ${camera}`);
      for (let i = 0; track && i < track.runs.length; i += 2) {
        const from = Math.round(this.x(track.runs[i]!) - LEFT);
        const to = Math.min(columns, Math.max(from + 1, Math.round(this.x(track.runs[i + 1]! + 1) - LEFT)));
        for (let at = from; at < to; at++) seen[at]!++;
      }
    }
    context.fillStyle = ofIndividual(lane.individual);
    for (let at = 0; at < columns; at++) {
      if (!seen[at]) continue;
      let end = at + 1;
      while (end < columns && seen[end] === seen[at]) end++;
      context.globalAlpha = 0.25 + 0.75 * Math.min(1, seen[at]! / Math.max(2, cameras.length));
      context.fillRect(LEFT + at, lane.top, end - at, lane.height);
      at = end - 1;
    }
    context.globalAlpha = 1;
  }

  private drawOne(context: CanvasRenderingContext2D, lane: Lane): void {
    this.name(context, lane, this.recording.cameras[lane.camera]!.name, false);
    context.fillStyle = colour("rail");
    context.fillRect(LEFT, lane.top + lane.height / 2 - 0.5, this.x(this.first + this.span) - LEFT, 1);
    const track = this.byPlace.get(`${lane.individual} ${lane.camera}`);
    context.fillStyle = ofIndividual(lane.individual);
    for (let i = 0; track && i < track.runs.length; i += 2) {
      const x = this.x(track.runs[i]!);
      context.fillRect(x, lane.top + 2, Math.max(1, this.x(track.runs[i + 1]! + 1) - x), lane.height - 4);
    }
  }

  /** Draw a mark where a camera takes one individual for another. */
  private drawSwaps(context: CanvasRenderingContext2D): void {
    context.fillStyle = colour("bad");
    for (const swap of this.recording.swaps) {
      for (const lane of this.lanes) {
        if (lane.camera !== swap.camera) continue;
        const x = this.x(swap.frame);
        context.beginPath();
        context.moveTo(x - 4, lane.top);
        context.lineTo(x + 4, lane.top);
        context.lineTo(x, lane.top + 7);
        context.fill();
      }
    }
  }

  private drawAxis(context: CanvasRenderingContext2D, width: number, height: number): void {
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = colour("muted");
    const step = niceStep(this.span / Math.max(2, (width - LEFT) / 90));
    for (let frame = Math.ceil(this.first / step) * step; frame < this.first + this.span; frame += step) {
      const x = this.x(frame);
      context.fillRect(x, height - 18, 1, 4);
      context.textAlign = x > width - 30 ? "right" : "center";
      context.fillText(String(frame), x, height - 7);
    }
    context.textAlign = "right";
    context.fillText("frame", LEFT - 10, height - 7);
  }
}

function inWords({ cameras, individuals }: Recording, { camera, frame, from, to }: Swap): string {
  return `${cameras[camera]!.name}: from frame ${frame} on the name of individual ${individuals[from]} is that of individual ${individuals[to]}.`;
}

/** Return in how many frames each camera saw each individual. */
function counts(recording: Recording, open = false): HTMLElement {
  const { run } = recording;
  const heads = ["Individual", term("Frames", explain(["individuals", 0, "frames"])), ...run.cameras.map((camera) => camera.name)];
  const rows = run.individuals.map((each, i) => h("tr", {},
    h("th", { scope: "row" }, h("span", { class: "dot", css: { "--own": ofIndividual(i) }, "aria-hidden": "true" }), figure(["individuals", i, "individual"], { quiet: true })),
    h("td", { class: "n" }, figure(["individuals", i, "frames"], { quiet: true })),
    ...run.cameras.map((camera) => h("td", { class: "n" }, each.cameras[camera.name] === undefined ? "never" : figure(["individuals", i, "cameras", camera.name], { quiet: true })))));
  return h("details", { open }, h("summary", {}, open ? "In numbers" : "The same in numbers"), table("Frames in which each camera saw each individual", heads, rows));
}

/** Return the third section. */
export function timelineSection(recording: Recording, player: Player): HTMLElement {
  const { individuals, cameras, tracks, swaps, swapsTotal } = recording;
  const few = individuals.length * cameras.length <= FEW;
  if (!tracks.length) {
    const why = individuals.length ? "The timeline needs the keypoints, and this report was made without them." : "No individual was found in two cameras.";
    return section("who", "Identities", why, counts(recording, true));
  }
  const timeline = new Timeline(recording, player, few);
  return section(
    "who",
    "Identities",
    "When each individual was found: the darker, the more cameras see it. Click to go to a frame; a click on a camera's line looks through it.",
    h("div", { class: "bar" }, tick("Each camera by itself", few, (on) => {
      timeline.byCamera = on;
      timeline.layOut();
    }), swaps.length ? h("span", { class: "swapkey" }, `▼ ${swapsTotal} times a file gives the name of one individual to another`) : null),
    timeline.element,
    swaps.length ? h("ul", { class: "small" }, ...swaps.slice(0, 12).map((swap) => h("li", {}, inWords(recording, swap)))) : null,
    counts(recording),
  );
}
