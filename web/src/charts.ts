/** Curves over time: uPlot, with the frame that is shown, in the page's colours. */
import uPlot from "uplot";
import { h } from "./dom";
import type { Player } from "./player";
import { colour, onTheme } from "./theme";

export interface Curve {
  label: string;
  /** A colour, or a function that gives it by the theme. */
  colour: () => string;
  values: (number | null)[];
  width?: number;
  dash?: number[];
}

export interface Plot {
  /** What it shows, in words, for those who cannot see it. */
  title: string;
  frames: number[];
  curves: Curve[];
  unit: string;
  height?: number;
  /** Whether the axis begins at 0. */
  zero?: boolean;
  legend?: boolean;
  /** Where the axis ends, whatever the values are. */
  top?: number;
}

/** Return 1, 2 or 5 times a power of ten, at least as large as asked. */
export function niceStep(wanted: number): number {
  const power = 10 ** Math.floor(Math.log10(Math.max(1, wanted)));
  return power * ([1, 2, 5].find((each) => each * power >= wanted) ?? 10);
}

/** Return numbers as uPlot takes them: null where there is nothing. */
export function values(numbers: ArrayLike<number>, from = 0, to = numbers.length): (number | null)[] {
  return Array.from({ length: to - from }, (_, i) => (Number.isFinite(numbers[from + i]!) ? numbers[from + i]! : null));
}

export class Chart {
  readonly element = h("div", { class: "chart", role: "img" });
  private plot: uPlot | null = null;
  private what: Plot | null = null;
  private readonly head = h("div", { class: "playhead", "aria-hidden": "true" });

  constructor(private readonly player: Player) {
    player.on((change) => change === "frame" && this.movePlayhead());
    onTheme(() => this.build());
    let width = 0;
    new ResizeObserver(() => {
      if (Math.abs(this.element.clientWidth - width) < 2) return;
      width = this.element.clientWidth;
      this.build();
    }).observe(this.element);
  }

  show(what: Plot): void {
    this.what = what;
    this.element.setAttribute("aria-label", what.title);
    this.build();
  }

  private build(): void {
    const { what } = this;
    const width = this.element.clientWidth;
    if (!what || !width) return;
    this.plot?.destroy();
    this.element.replaceChildren();
    const { frames, curves, unit, height = 190, zero = true, legend = true, top } = what;
    if (!curves.some((curve) => curve.values.some((value) => value !== null))) {
      this.plot = null;
      this.element.append(h("p", { class: "none" }, "Nothing to show: not known in this recording."));
      return;
    }
    const axis = { stroke: colour("muted"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const options: uPlot.Options = {
      width,
      height,
      legend: { show: legend, live: true },
      cursor: { y: false, points: { size: 6 }, drag: { x: false, y: false } },
      scales: { x: { time: false }, y: zero ? { range: (_, __, high) => [0, top ?? (high || 1) * 1.08] } : {} },
      axes: [{ ...axis, size: 30 }, { ...axis, size: 52, values: (_, ticks) => ticks.map((tick) => `${Number(tick.toPrecision(4))}`) }],
      series: [
        { label: "frame" },
        ...curves.map((curve) => ({
          label: curve.label, stroke: curve.colour(), width: curve.width ?? 1.6, dash: curve.dash, spanGaps: false,
          points: { show: frames.length < 3 },
          value: (_: uPlot, value: number | null) => (value === null ? "–" : `${Number(value.toPrecision(3))}${unit}`),
        }) as uPlot.Series),
      ],
    };
    this.plot = new uPlot(options, [frames, ...curves.map((curve) => curve.values)], this.element);
    this.plot.over.append(this.head);
    this.plot.over.addEventListener("click", (event) => this.player.seekFrame(this.plot!.posToVal(event.offsetX, "x")));
    this.movePlayhead();
  }

  private movePlayhead(): void {
    const frame = this.player.frames[this.player.index];
    if (!this.plot || frame === undefined) return;
    this.head.style.setProperty("transform", `translateX(${this.plot.valToPos(frame, "x")}px)`);
  }
}
