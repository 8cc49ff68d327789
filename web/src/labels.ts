/** Names over the 3D view: those that would lie over others are left out. */
import { fit } from "./dom";
import { colour } from "./theme";

export interface Label {
  x: number;
  y: number;
  depth: number;
  text: string;
  colour: string;
  /** Drawn before others. */
  first: boolean;
  /** A disc with the text in it. */
  badge?: boolean;
}

const MOST = 22;

/** Return a name that fits into a label. */
export function short(name: string, most = MOST): string {
  return name.length <= most ? name : `${name.slice(0, most - 8)}…${name.slice(-7)}`;
}

const widths = new Map<string, number>();

/** Return how wide a text is; asking the canvas each time is slow. */
export function widthOf(context: CanvasRenderingContext2D, text: string): number {
  const key = `${context.font} ${text}`;
  let width = widths.get(key);
  if (width === undefined) {
    width = context.measureText(text).width;
    widths.set(key, width);
  }
  return width;
}

export function drawLabels(canvas: HTMLCanvasElement, labels: Label[]): void {
  const fitted = fit(canvas);
  if (!fitted) return;
  const [context, room] = fitted;
  const taken: [number, number, number, number][] = [];
  const order = labels.filter((label) => label.depth < 1).sort((a, b) => Number(b.first) - Number(a.first) || a.depth - b.depth);
  const ground = colour("stage");
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineJoin = "round";
  for (const label of order) {
    const text = short(label.text);
    context.font = label.badge ? "600 11px system-ui, sans-serif" : "500 12px system-ui, sans-serif";
    const width = widthOf(context, text) + 8;
    if (label.x < 0 || label.x > room) continue;
    const x = Math.max(width / 2, Math.min(room - width / 2, label.x));
    const box: [number, number, number, number] = [x - width / 2, label.y - 9, x + width / 2, label.y + 9];
    if (taken.some((other) => box[0] < other[2] && box[2] > other[0] && box[1] < other[3] && box[3] > other[1])) continue;
    taken.push(box);
    if (label.badge) {
      context.fillStyle = label.colour;
      context.beginPath();
      context.roundRect(box[0], box[1] + 1, width, 16, 8);
      context.fill();
      context.fillStyle = ground;
      context.fillText(text, x, label.y + 0.5);
    } else {
      context.strokeStyle = ground;
      context.lineWidth = 4;
      context.strokeText(text, x, label.y);
      context.fillStyle = label.colour;
      context.fillText(text, x, label.y);
    }
  }
}
