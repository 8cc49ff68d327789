/**
 * The contract between mocap_calib/html_report (which makes the data) and the page (which shows it).
 *
 * The data lie as JSON in <script type="application/json" id="report-data">, with <, >, &, U+2028
 * and U+2029 escaped. All names are text from files: never HTML.
 *
 * Conventions: frames are numbers on the common clock, as poses3d.csv has them. Pixels have their
 * origin in the centre of the first pixel (OpenCV). Transforms are cam_from_world: x_cam = R x + t.
 * Matrices are rows one after the other. Lengths are in `rig.unit` ("m", "mm", ... or "arbitrary").
 * Not known is null; in float arrays NaN; in int16 arrays -32768; individuals that are nobody -1.
 */

/**
 * An array: little-endian numbers, in base64 of zlib (DecompressionStream "deflate").
 *
 * To read it: inflate; the bytes are in planes (all first bytes of the numbers, then all second
 * bytes, ...; `int16`: value i = bytes[i] | bytes[n + i] << 8). Where `delta` is an axis, integers
 * are differences along it (modulo 2^bits): sum them up along that axis, wrapping round.
 * After that -32768 is missing. Values are integer * scale (+ offset) where the owner says so.
 */
export interface Packed {
  dtype: "int8" | "uint8" | "int16" | "uint16" | "int32" | "float32";
  shape: number[];
  /** Index of the axis along which differences are stored; null where values are as they are. */
  delta: number | null;
  /** Base64; an empty array is an empty text. */
  data: string;
}

/** UTF-8 text, in base64 of zlib. */
export interface PackedText {
  text: string;
}

export interface ReportData {
  /** Goes up when the contract changes. */
  schema: 1;
  /** What the report is of: the name of the folder of the results. */
  title: string;
  /** run.json of the group, whole: every number of the page that stands in it comes from it. */
  run: PackedText;
  /** What the page must say of itself, a line each: frames left out, detections not there, ... */
  notes: string[];
  /** Checks of the verdict: what each is and what sound recordings show. By `checks[].name`. */
  checks: Record<string, { text: string; sound: [number, number] }>;
  rig: Rig;
  /** Another rig laid over this one by the best similarity (`report --reference`). */
  reference: Reference | null;
  skeleton: Skeleton;
  poses: Poses;
  /** What the cameras saw; null where no keypoints were read. */
  detections: Detections | null;
  /** How the cameras fit what they saw; null where no keypoints were read. */
  fits: Fits | null;
  timeline: Timeline | null;
  series: Series;
}

export interface RigCamera {
  /** Name of the view: a camera that was moved is several, `cam2` and `cam2@573` from frame 573. */
  name: string;
  /** Index into run.cameras: several views may be one camera. */
  camera: number;
  /** First and last frame at which it stands here. */
  first: number;
  last: number;
  /** (width, height) in pixels, [0, 0] where not stated. */
  size: [number, number];
  /** 3 x 3. */
  matrix: number[];
  /** OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 (any number up to 8), or 4 of cv2.fisheye. */
  distortion: number[];
  fisheye: boolean;
  rotation: number[];
  translation: number[];
  /**
   * 3 x 3 covariance of the centre in the world, in the unit squared, after the best similarity
   * (one standard deviation: sqrt of its eigenvalues). null where it is not known.
   */
  covariance: number[] | null;
}

export interface Rig {
  unit: string;
  /** Unit vector against gravity; null where it is not known. */
  up: number[] | null;
  /** A point of the floor; null where it is not known. */
  floor: number[] | null;
  /** RMS distance of the centres from their middle. */
  size: number;
  /** "axes": covariances have directions; "spheres": only their size is known (made of a folder). */
  covariance: "axes" | "spheres";
  cameras: RigCamera[];
}

export interface Reference {
  /** Name of its file. */
  title: string;
  /** Already aligned: in the world of the rig, in its unit. `covariance` is null. */
  cameras: Omit<RigCamera, "camera" | "first" | "last">[];
  /** Of the cameras that both have, after the best similarity; place in percent of the rig's size. */
  errors: { name: string; rotation_deg: number; centre_percent: number; centre: number }[];
}

export interface Skeleton {
  joints: string[];
  edges: [number, number][];
  /** [joint] */
  sides: ("left" | "right" | "middle")[];
}

export interface Poses {
  /** [frame] int32: numbers of the frames that are here, ascending. */
  frames: Packed;
  /** How many frames the recording has. More than are here: playback jumps between stretches. */
  total: number;
  /** Indices into `frames` at which a stretch of frames that follow each other begins; [0] first. */
  stretches: number[];
  /** Frames a second; null where nobody said (--fps). */
  fps: number | null;
  /** [individual] numbers, as run.individuals has them. */
  individuals: number[];
  /** Position = offset + scale * integer; -32768 in all three = missing. */
  scale: number;
  offset: [number, number, number];
  /** [individual, frame, joint, 3] int16, delta along the frames. */
  points: Packed;
  /**
   * [individual, frame, joint] uint8, delta along the frames: what a point is made of.
   * 0 missing, 1 triangulated, 2 one view, 3 model, 4 interpolated.
   */
  source: Packed;
}

export interface Detections {
  /**
   * Indices into `poses.frames` (uint16 or int32), ascending: frames whose detections are here.
   * In other frames nothing is known of the detections: draw reprojections alone and say so.
   */
  frames: Packed;
  /** [camera], in the order of rig.cameras. */
  cameras: CameraDetections[];
}

export interface CameraDetections {
  /** [row] int32, delta along the rows: index into `Detections.frames`. */
  frame: Packed;
  /** [row] int16, delta: index into `poses.individuals`, -1 = nobody. Rows go by individual, then frame. */
  individual: Packed;
  /** Pixels = scale * integer. */
  scale: number;
  /** [row, joint, 2] int16, delta along the rows; -32768 = not detected. */
  points: Packed;
}

export interface Fits {
  /** Cells of the image: column = floor(x / width * columns), the same for all cameras. */
  columns: number;
  rows: number;
  /** [camera, row, column] int32: keypoints that were matched, in the frames looked at. */
  counts: Packed;
  /** [camera, row, column] int32: keypoints that nobody else confirms. */
  unmatched: Packed;
  /** Pixels = residual_scale * integer. */
  residual_scale: number;
  /**
   * [camera, row, column, 2] int16: mean of where the 3D point is seen less where it was detected;
   * x right, y down. -32768 = nothing there.
   */
  residuals: Packed;
  /** [camera, joint] float32: median reprojection error in pixels, NaN = none. */
  by_joint: Packed;
  /** [bin] numbers of the first frames of bins, and [camera, bin] float32 median and 95th percentile. */
  bins: number[];
  median: Packed;
  p95: Packed;
  /** How many frames were looked at (evenly spaced), of `poses.total`. */
  looked_at: number;
}

export interface Timeline {
  /** [run, 4] int32: camera (index into rig.cameras), index of the individual, first, last frame. */
  runs: Packed;
  /** Gaps of up to so many frame numbers are closed: 0 = all gaps are shown. */
  closed: number;
  /**
   * Where a file of a camera that names individuals gives one name to another individual:
   * [swap, 4] int32: camera, frame from which on, and indices of the individuals from, to.
   */
  swaps: Packed;
  /** How many swaps there are; more than rows: the first ones are here. */
  swaps_total: number;
}

/** What bodies do over time: of all frames, in bins of equal numbers of frames. */
export interface Series {
  /** [bin] numbers of the first frames. */
  bins: number[];
  /** [individual, edge, bin] float32: median length in the unit. */
  bones: Packed;
  /** [individual, bin] float32: median height of the highest joint above the floor; null: no floor. */
  height: Packed | null;
  /** [individual, bin] float32: median speed of the trunk, in the unit per second; per frame where fps is null. */
  speed: Packed;
}
