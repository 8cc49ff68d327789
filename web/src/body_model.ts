/** Bodies in 3D: bones, their shadows on the floor, and trails. */
import { Group } from "three";
import { Lines } from "./lines";
import { channels, ofIndividual } from "./palette";
import { middleOf, offsetOf, type Recording } from "./recording";
import { colour } from "./theme";

const TRAIL = 40;

export interface BodyOptions {
  trails: boolean;
  /** Whether there is time for wide trails and for shadows. */
  detail: boolean;
  follow: number;
}

export class BodyModel {
  readonly group = new Group();
  private readonly bones: Lines;
  private readonly trails: Lines;
  private readonly shadows: Lines;
  private readonly flat = [new Float32Array(3), new Float32Array(3)] as const;

  constructor(private readonly recording: Recording) {
    const { individuals, edges } = recording;
    this.bones = new Lines(individuals.length * edges.length, 3.5);
    this.trails = new Lines(individuals.length * TRAIL, 2);
    this.shadows = new Lines(individuals.length * edges.length, 4, true);
    this.group.add(this.shadows.object, this.trails.object, this.bones.object);
  }

  /** Draw all bodies at a frame. */
  update(frame: number, { trails, detail, follow }: BodyOptions): void {
    const ground = channels(colour("stage"));
    const shade = blend(ground, channels(colour("ink")), 0.12);
    const shadows = detail && this.recording.floor !== null;
    this.trails.wide = detail;
    for (const lines of [this.bones, this.trails, this.shadows]) lines.clear();
    this.recording.individuals.forEach((_, index) => {
      const own = channels(ofIndividual(index));
      const faint = follow >= 0 && follow !== index;
      const shown = faint ? blend(own, ground, 0.7) : own;
      this.addBones(index, frame, shown, shadows ? shade : null);
      if (trails && !faint) this.addTrail(index, frame, shown, ground);
    });
    for (const lines of [this.bones, this.trails, this.shadows]) lines.done();
  }

  private addBones(index: number, frame: number, shown: number[], shade: number[] | null): void {
    const { points, edges } = this.recording;
    const start = offsetOf(this.recording, index, frame);
    for (const [a, b] of edges) {
      const [i, j] = [start + 3 * a, start + 3 * b];
      // NaN is not equal to itself
      if (points[i] !== points[i] || points[j] !== points[j]) continue;
      this.bones.add(points, i, points, j, shown);
      if (shade) this.shadows.add(this.drop(points, i, 0), 0, this.drop(points, j, 1), 0, shade);
    }
  }

  /** Return the point below a point on the floor. */
  private drop(points: Float32Array, at: number, slot: 0 | 1): Float32Array {
    const { up, floor } = this.recording;
    const base = floor ?? [0, 0, 0];
    const height = [0, 1, 2].reduce((sum, k) => sum + up[k]! * (points[at + k]! - base[k]!), 0);
    const to = this.flat[slot];
    for (let k = 0; k < 3; k++) to[k] = points[at + k]! - height * up[k]!;
    return to;
  }

  private addTrail(index: number, frame: number, shown: number[], ground: number[]): void {
    let after = middleOf(this.recording, index, frame);
    const { breaks } = this.recording;
    for (let back = 1; back <= Math.min(TRAIL, frame) && !breaks.has(frame - back + 1); back++) {
      const before = middleOf(this.recording, index, frame - back);
      if (before && after) {
        const [from, to] = [back / TRAIL, (back - 1) / TRAIL].map((share) => blend(shown, ground, share));
        this.trails.add(before, 0, after, 0, from!, to!);
      }
      after = before;
    }
  }
}

function blend(a: readonly number[], b: readonly number[], share: number): number[] {
  return a.map((value, k) => value + (b[k]! - value) * share);
}
