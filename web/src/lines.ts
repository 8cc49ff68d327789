/** Many line segments in one buffer: one call to draw them all, wide or, where drawing is slow, thin. */
import { BufferGeometry, DynamicDrawUsage, Group, InstancedInterleavedBuffer, InterleavedBuffer, InterleavedBufferAttribute, LineBasicMaterial, LineSegments } from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

export class Lines {
  readonly object = new Group();
  /** Whether lines have a width: that is six times the work. */
  wide = true;
  private readonly places: Float32Array;
  private readonly colours: Float32Array;
  private readonly wideLines: LineSegments2;
  private readonly thinLines: LineSegments;
  private readonly buffers: { wide: InterleavedBuffer[]; thin: InterleavedBuffer[] };
  private count = 0;

  /** most: how many segments there may be; width: in pixels; ground: whether others may lie on them. */
  constructor(readonly most: number, width: number, ground = false) {
    this.places = new Float32Array(6 * Math.max(1, most));
    this.colours = new Float32Array(6 * Math.max(1, most));
    const wide = [this.places, this.colours].map((array) => new InstancedInterleavedBuffer(array, 6, 1));
    const thin = [this.places, this.colours].map((array) => new InterleavedBuffer(array, 3));
    for (const buffer of [...wide, ...thin]) buffer.setUsage(DynamicDrawUsage);
    this.buffers = { wide, thin };
    const material = { vertexColors: true, depthWrite: !ground };
    const geometry = new LineSegmentsGeometry();
    ["instanceStart", "instanceEnd", "instanceColorStart", "instanceColorEnd"].forEach((name, i) => {
      geometry.setAttribute(name, new InterleavedBufferAttribute(wide[i >> 1]!, 3, 3 * (i % 2)));
    });
    this.wideLines = new LineSegments2(geometry, new LineMaterial({ ...material, linewidth: width }));
    const thinGeometry = new BufferGeometry();
    ["position", "color"].forEach((name, i) => thinGeometry.setAttribute(name, new InterleavedBufferAttribute(thin[i]!, 3, 0)));
    this.thinLines = new LineSegments(thinGeometry, new LineBasicMaterial(material));
    for (const lines of [this.wideLines, this.thinLines]) {
      lines.frustumCulled = false;
      lines.renderOrder = ground ? -1 : 0;
      this.object.add(lines);
    }
  }

  /** Begin anew: what was added is gone. */
  clear(): void {
    this.count = 0;
  }

  /** Add a segment from one point to another, in one colour or fading into a second. */
  add(a: ArrayLike<number>, i: number, b: ArrayLike<number>, j: number, from: readonly number[], to = from): void {
    if (this.count >= this.most) return;
    const [places, colours, at] = [this.places, this.colours, 6 * this.count++];
    for (let k = 0; k < 3; k++) {
      places[at + k] = a[i + k]!;
      places[at + 3 + k] = b[j + k]!;
      colours[at + k] = from[k]!;
      colours[at + 3 + k] = to[k]!;
    }
  }

  /** Show what was added. */
  done(): void {
    this.wideLines.geometry.instanceCount = this.count;
    this.thinLines.geometry.setDrawRange(0, 2 * this.count);
    this.wideLines.visible = this.wide && this.count > 0;
    this.thinLines.visible = !this.wide && this.count > 0;
    for (const buffer of this.buffers[this.wide ? "wide" : "thin"]) {
      buffer.clearUpdateRanges();
      buffer.addUpdateRange(0, 6 * this.count);
      buffer.needsUpdate = true;
    }
  }
}
