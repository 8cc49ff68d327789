/** What the page works on: the report's data, unpacked. */
import { centreOf, type CameraModel } from "./camera_model";
import type * as Data from "./data";
import type { Run } from "./run";
import { unpack, unpackText, type Numbers } from "./unpack";

const MISSING = -32768;
type Vector = [number, number, number];

/** What one camera saw: rows are detections, in order of frames. */
export interface Detections {
  /** Row at which each frame of the recording begins, and one more. */
  starts: Int32Array;
  /** Index of the individual, -1 nobody. */
  individuals: Int16Array;
  /** x and y of every joint in pixels, NaN where it was not seen. */
  points: Float32Array;
}

export interface Fits {
  columns: number;
  rows: number;
  counts: Numbers;
  unmatched: Numbers;
  /** x and y in pixels, NaN where there is nothing. */
  residuals: Float32Array;
  byJoint: Numbers;
  bins: number[];
  median: Numbers;
  p95: Numbers;
  lookedAt: number;
}

/** Where one individual was matched in one camera: first and last frame numbers, in turn. */
export interface Track {
  camera: number;
  individual: number;
  runs: number[];
}

export interface Swap {
  camera: number;
  frame: number;
  from: number;
  to: number;
}

export interface Series {
  bins: number[];
  /** [individual, edge, bin] */
  bones: Numbers;
  /** [individual, bin]; null where no floor is known. */
  height: Numbers | null;
  speed: Numbers;
}

export interface Recording {
  title: string;
  notes: string[];
  run: Run;
  checks: Data.ReportData["checks"];
  cameras: Data.RigCamera[];
  centres: Vector[];
  covarianceKind: "axes" | "spheres";
  reference: Data.Reference | null;
  /** Against gravity; where that is not known, what the cameras take for up. */
  up: Vector;
  upKnown: boolean;
  floor: Vector | null;
  unit: string;
  joints: string[];
  edges: [number, number][];
  sides: ("left" | "right" | "middle")[];
  frames: Int32Array;
  total: number;
  /** Which frames do not follow the one before: nothing joins them. */
  breaks: Set<number>;
  /** Frames a second, null where nobody said. */
  fps: number | null;
  individuals: number[];
  /** [individual, frame, joint, 3], NaN where missing. */
  points: Float32Array;
  /** By camera; null where no keypoints were read. */
  detections: Detections[] | null;
  /** Of each frame, whether its detections are here. */
  looked: Uint8Array;
  fits: Fits | null;
  tracks: Track[];
  swaps: Swap[];
  swapsTotal: number;
  series: Series;
}

/** Return the report's data, unpacked. */
export async function read(data: Data.ReportData): Promise<Recording> {
  const { rig, skeleton, poses, series } = data;
  const [run, frames, points, bones, height, speed] = await Promise.all([
    unpackText(data.run.text),
    unpack(poses.frames),
    unpack(poses.points),
    unpack(series.bones),
    series.height && unpack(series.height),
    unpack(series.speed),
  ]);
  const looked = new Uint8Array(frames.length);
  return {
    title: data.title,
    notes: data.notes,
    run: JSON.parse(run) as Run,
    checks: data.checks,
    cameras: rig.cameras,
    centres: rig.cameras.map(centreOf),
    covarianceKind: rig.covariance,
    reference: data.reference,
    up: (rig.up ?? upOf(rig.cameras)) as Vector,
    upKnown: rig.up !== null,
    floor: rig.floor as Vector | null,
    unit: rig.unit,
    ...skeleton,
    frames: frames as Int32Array,
    total: poses.total,
    breaks: new Set(poses.stretches.filter((at) => at > 0)),
    fps: poses.fps,
    individuals: poses.individuals,
    points: scaled(points as Int16Array, poses.scale, poses.offset),
    detections: data.detections && await readDetections(data.detections, skeleton.joints.length, looked),
    looked,
    fits: data.fits && await readFits(data.fits),
    ...await readTimeline(data.timeline),
    series: { bins: series.bins, bones, height, speed },
  };
}

/** Return what the cameras together take for up: the mean of their images' upward directions. */
function upOf(cameras: CameraModel[]): number[] {
  const sum = [0, 1, 2].map((k) => cameras.reduce((all, camera) => all - camera.rotation[3 + k]!, 0));
  const length = Math.hypot(...sum);
  return length > 1e-6 ? sum.map((each) => each / length) : [0, 0, 1];
}

/** Return positions: integers times a scale, on top of an offset; missing ones are NaN. */
function scaled(integers: Int16Array, scale: number, offset: number[]): Float32Array {
  const size = offset.length;
  const values = new Float32Array(integers.length);
  for (let i = 0; i < values.length; i++) {
    values[i] = integers[i] === MISSING ? NaN : integers[i]! * scale + offset[i % size]!;
  }
  return values;
}

async function readDetections(data: Data.Detections, joints: number, looked: Uint8Array): Promise<Detections[]> {
  const frames = await unpack(data.frames);
  for (const frame of frames) looked[frame] = 1;
  return Promise.all(data.cameras.map(async (camera) => {
    const [frame, individual, points] = await Promise.all([unpack(camera.frame), unpack(camera.individual), unpack(camera.points)]);
    return byFrame(frame, frames, individual, scaled(points as Int16Array, camera.scale, [0, 0]), looked.length, 2 * joints);
  }));
}

/** Return the rows in order of frames. */
function byFrame(frame: Numbers, frames: Numbers, individual: Numbers, points: Float32Array, count: number, stride: number): Detections {
  const starts = new Int32Array(count + 1);
  for (const at of frame) starts[frames[at]! + 1]!++;
  for (let i = 0; i < count; i++) starts[i + 1]! += starts[i]!;
  const next = starts.slice();
  const sorted = { starts, individuals: new Int16Array(frame.length), points: new Float32Array(points.length) };
  frame.forEach((at, row) => {
    const to = next[frames[at]!]!++;
    sorted.individuals[to] = individual[row]!;
    sorted.points.set(points.subarray(row * stride, (row + 1) * stride), to * stride);
  });
  return sorted;
}

async function readFits(data: Data.Fits): Promise<Fits> {
  const [counts, unmatched, residuals, byJoint, median, p95] = await Promise.all(
    [data.counts, data.unmatched, data.residuals, data.by_joint, data.median, data.p95].map(unpack),
  ) as [Numbers, Numbers, Int16Array, Numbers, Numbers, Numbers];
  const { columns, rows, bins } = data;
  return { columns, rows, bins, counts, unmatched, byJoint, median, p95, lookedAt: data.looked_at,
    residuals: scaled(residuals, data.residual_scale, [0, 0]) };
}

async function readTimeline(data: Data.Timeline | null): Promise<{ tracks: Track[]; swaps: Swap[]; swapsTotal: number }> {
  if (!data) return { tracks: [], swaps: [], swapsTotal: 0 };
  const [runs, rows] = await Promise.all([unpack(data.runs), unpack(data.swaps)]);
  const tracks = new Map<string, Track>();
  for (let i = 0; i < runs.length; i += 4) {
    const [camera, individual] = [runs[i]!, runs[i + 1]!];
    const key = `${camera} ${individual}`;
    const track = tracks.get(key) ?? { camera, individual, runs: [] };
    track.runs.push(runs[i + 2]!, runs[i + 3]!);
    tracks.set(key, track);
  }
  const swaps: Swap[] = [];
  for (let i = 0; i < rows.length; i += 4) {
    swaps.push({ camera: rows[i]!, frame: rows[i + 1]!, from: rows[i + 2]!, to: rows[i + 3]! });
  }
  return { tracks: [...tracks.values()], swaps, swapsTotal: data.swaps_total };
}

/** Return where the points of one individual in one frame begin in `points`. */
export function offsetOf(recording: Recording, individual: number, frame: number): number {
  return (individual * recording.frames.length + frame) * recording.joints.length * 3;
}

const middles = new WeakMap<Recording, Map<number, Vector | null>>();

/** Return the middle of a body: the medians of its joints, or null where it is not there. */
export function middleOf(recording: Recording, individual: number, frame: number): Vector | null {
  const known = middles.get(recording) ?? new Map<number, Vector | null>();
  middles.set(recording, known);
  const start = offsetOf(recording, individual, frame);
  let middle = known.get(start);
  if (middle === undefined) {
    const { points, joints } = recording;
    const at = (axis: number): number => {
      const values: number[] = [];
      for (let i = start + axis; i < start + 3 * joints.length; i += 3) {
        if (points[i] === points[i]) values.push(points[i]!);
      }
      return median(values);
    };
    const found: Vector = [at(0), at(1), at(2)];
    middle = found[0] === found[0] ? found : null;
    known.set(start, middle);
  }
  return middle;
}

/** Return the median of numbers, NaN of none. */
export function median(values: number[]): number {
  if (!values.length) return NaN;
  const sorted = values.slice().sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half]! : (sorted[half - 1]! + sorted[half]!) / 2;
}
