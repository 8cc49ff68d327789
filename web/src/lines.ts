/** Many wide line segments in one buffer: one call to draw them all. */
import { InstancedInterleavedBuffer, InterleavedBufferAttribute, DynamicDrawUsage } from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

export class Lines {
  readonly object: LineSegments2;
  readonly geometry = new LineSegmentsGeometry();
  private readonly places: InstancedInterleavedBuffer;
  private readonly colours: InstancedInterleavedBuffer;
  private count = 0;

  /** most: how many segments there may be; width: in pixels. */
  constructor(readonly most: number, width: number, opacity = 1) {
    const attribute = (): InstancedInterleavedBuffer => {
      const buffer = new InstancedInterleavedBuffer(new Float32Array(6 * Math.max(1, most)), 6, 1);
      buffer.setUsage(DynamicDrawUsage);
      return buffer;
    };
    this.places = attribute();
    this.colours = attribute();
    this.geometry.setAttribute("instanceStart", new InterleavedBufferAttribute(this.places, 3, 0));
    this.geometry.setAttribute("instanceEnd", new InterleavedBufferAttribute(this.places, 3, 3));
    this.geometry.setAttribute("instanceColorStart", new InterleavedBufferAttribute(this.colours, 3, 0));
    this.geometry.setAttribute("instanceColorEnd", new InterleavedBufferAttribute(this.colours, 3, 3));
    const material = new LineMaterial({ linewidth: width, vertexColors: true, transparent: opacity < 1, opacity, depthWrite: opacity === 1 });
    this.object = new LineSegments2(this.geometry, material);
    this.object.frustumCulled = false;
  }

  /** Begin anew: what was added is gone. */
  clear(): void {
    this.count = 0;
  }

  /** Add a segment from one point to another, in one colour or fading into a second. */
  add(a: ArrayLike<number>, i: number, b: ArrayLike<number>, j: number, from: readonly number[], to = from): void {
    if (this.count >= this.most) return;
    const [places, colours, at] = [this.places.array, this.colours.array, 6 * this.count++];
    for (let k = 0; k < 3; k++) {
      places[at + k] = a[i + k]!;
      places[at + 3 + k] = b[j + k]!;
      colours[at + k] = from[k]!;
      colours[at + 3 + k] = to[k]!;
    }
  }

  /** Show what was added. */
  done(): void {
    this.geometry.instanceCount = this.count;
    this.object.visible = this.count > 0;
    this.places.needsUpdate = true;
    this.colours.needsUpdate = true;
  }
}
