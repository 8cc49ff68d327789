/** The cameras in 3D: frusta, error ellipsoids and the rig of reference. */
import { Color, Group, InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { centreOf, cornersOf, type CameraModel } from "./camera_model";
import { Lines } from "./lines";
import { channels } from "./palette";
import { median, type Recording } from "./recording";
import { openFaults } from "./run";
import { colour } from "./theme";

const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

/** More cameras have ellipsoids of fewer faces. */
const MANY = 12;

export interface RigOptions {
  ellipsoids: boolean;
  reference: boolean;
  /** Whether there is time for wide lines. */
  detail: boolean;
}

export class RigModel {
  readonly group = new Group();
  readonly size: number;
  /** How many times larger than a standard deviation ellipsoids are drawn. */
  exaggeration = 1;
  private readonly frusta: Lines;
  private readonly reference: Lines;
  private readonly ellipsoids: InstancedMesh;
  private readonly factors: (Matrix4 | null)[];

  constructor(private readonly recording: Recording) {
    const { cameras, centres } = recording;
    const references = recording.reference?.cameras.length ?? 0;
    this.size = sizeOf(centres);
    this.frusta = new Lines(10 * cameras.length, 2);
    this.reference = new Lines(10 * references, 1.5);
    this.factors = cameras.map((camera) => (camera.covariance ? rootOf(camera.covariance) : null));
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.35, depthWrite: false });
    this.ellipsoids = new InstancedMesh(new SphereGeometry(1, ...(cameras.length > MANY ? [10, 7] : [24, 16])), material, Math.max(1, cameras.length));
    this.ellipsoids.frustumCulled = false;
    this.group.add(this.frusta.object, this.reference.object, this.ellipsoids);
    this.exaggeration = this.usualExaggeration();
  }

  /** Return the factor at which the largest ellipsoid is about as large as a frustum. */
  private usualExaggeration(): number {
    const sizes = this.recording.cameras.map(({ covariance: c }) => (c ? Math.sqrt(Math.max(c[0]!, c[4]!, c[8]!)) : 0));
    const largest = Math.max(0, ...sizes);
    const wanted = largest ? (0.8 * this.size) / largest : 1;
    return STEPS.filter((step) => step <= wanted).at(-1) ?? 1;
  }

  /** Draw the cameras that stand here at a frame, the chosen one apart. */
  update(chosen: number, frame: number, { ellipsoids, reference, detail }: RigOptions): void {
    const { recording } = this;
    const [usual, accent, warn, faint] = ["ink", "accent", "bad", "muted"].map((name) => channels(colour(name)));
    this.frusta.wide = this.reference.wide = detail;
    this.frusta.clear();
    recording.cameras.forEach((camera, view) => {
      if (!standsAt(camera, frame)) return;
      const about = recording.run.cameras[camera.camera];
      const doubtful = about && (about.weak || openFaults(about).length > 0);
      drawFrustum(this.frusta, camera, view === chosen ? 1.25 * this.size : this.size,
        view === chosen ? accent! : doubtful ? warn! : usual!);
    });
    this.frusta.done();
    this.reference.clear();
    if (reference) for (const camera of recording.reference?.cameras ?? []) drawFrustum(this.reference, camera, 0.85 * this.size, faint!);
    this.reference.done();
    this.drawEllipsoids(ellipsoids, frame);
  }

  private drawEllipsoids(show: boolean, frame: number): void {
    const { ellipsoids } = this;
    (ellipsoids.material as MeshBasicMaterial).color = new Color(colour("fair"));
    this.factors.forEach((factor, view) => {
      const stands = standsAt(this.recording.cameras[view]!, frame);
      const matrix = factor && stands ? factor.clone() : new Matrix4().makeScale(0, 0, 0);
      matrix.scale(new Vector3().setScalar(this.exaggeration));
      matrix.setPosition(...this.recording.centres[view]!);
      ellipsoids.setMatrixAt(view, matrix);
    });
    ellipsoids.visible = show && this.factors.some(Boolean);
    ellipsoids.instanceMatrix.needsUpdate = true;
  }
}

/** Return whether a camera stands where it says at a frame: one that was moved is several. */
export function standsAt(camera: { first: number; last: number }, frame: number): boolean {
  return frame >= camera.first && frame <= camera.last;
}

/** Return how long frusta are: a share of the rig, less where cameras stand side by side. */
function sizeOf(centres: [number, number, number][]): number {
  const between = (a: number[], b: number[]): number => Math.hypot(a[0]! - b[0]!, a[1]! - b[1]!, a[2]! - b[2]!);
  const nearest = centres.map((a) => Math.min(...centres.filter((b) => b !== a).map((b) => between(a, b))));
  const middle = [0, 1, 2].map((k) => centres.reduce((sum, c) => sum + c[k]!, 0) / centres.length);
  const radius = median(centres.map((c) => between(c, middle))) || 1;
  const usual = median(nearest.filter(Number.isFinite));
  return Math.max(0.05 * radius, Math.min(0.16 * radius, 0.5 * (usual || radius)));
}

/** Add the lines of one camera: four edges, the image, and a roof that shows where up is. */
function drawFrustum(lines: Lines, camera: CameraModel, size: number, shade: readonly number[]): void {
  const centre = centreOf(camera);
  const rays = cornersOf(camera);
  // as wide as a usual camera's whatever the lens: the half diagonal is 0.6 of the length
  const spread = Math.hypot(...[0, 1, 2].map((k) => rays[0]![k]! - rays[2]![k]!)) / 2;
  const depth = spread > 0.6 ? (0.6 * size) / spread : size;
  const corners = rays.map((ray) => ray.map((value, k) => centre[k]! + depth * value));
  corners.forEach((corner, i) => {
    lines.add(centre, 0, corner, 0, shade);
    lines.add(corner, 0, corners[(i + 1) % 4]!, 0, shade);
  });
  const [a, b, , d] = corners as [number[], number[], number[], number[]];
  const roof = [0, 1, 2].map((k) => (a[k]! + b[k]!) / 2 + 0.35 * (a[k]! - d[k]!));
  lines.add(a, 0, roof, 0, shade);
  lines.add(roof, 0, b, 0, shade);
}

/** Return a matrix that makes an ellipsoid of a unit sphere: the Cholesky factor. */
function rootOf(c: number[]): Matrix4 {
  const a = Math.sqrt(Math.max(c[0]!, 1e-30));
  const [b, d] = [c[3]! / a, c[6]! / a];
  const e = Math.sqrt(Math.max(c[4]! - b * b, 1e-30));
  const f = (c[7]! - d * b) / e;
  const g = Math.sqrt(Math.max(c[8]! - d * d - f * f, 1e-30));
  return new Matrix4().set(a, 0, 0, 0, b, e, 0, 0, d, f, g, 0, 0, 0, 0, 1);
}
