/** Projection into an image, as OpenCV has it, with lens and fisheye. */

export interface CameraModel {
  name: string;
  size: [number, number];
  matrix: number[];
  distortion: number[];
  fisheye: boolean;
  /** cam_from_world: nine numbers, row by row. */
  rotation: number[];
  translation: number[];
}

/** Return where a point of the world is in the image, or null where it is behind the camera. */
export function project(camera: CameraModel, x: number, y: number, z: number): [number, number] | null {
  const { rotation: r, translation: t } = camera;
  const cz = r[6]! * x + r[7]! * y + r[8]! * z + t[2]!;
  if (!(cz > 0)) return null;
  const a = (r[0]! * x + r[1]! * y + r[2]! * z + t[0]!) / cz;
  const b = (r[3]! * x + r[4]! * y + r[5]! * z + t[1]!) / cz;
  const [u, v] = camera.fisheye ? fisheye(camera.distortion, a, b) : lens(camera.distortion, a, b);
  const k = camera.matrix;
  return [k[0]! * u + k[1]! * v + k[2]!, k[4]! * v + k[5]!];
}

function lens(d: number[], a: number, b: number): [number, number] {
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = d;
  const r2 = a * a + b * b;
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  return [
    a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
    b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b,
  ];
}

function fisheye(d: number[], a: number, b: number): [number, number] {
  const [k1 = 0, k2 = 0, k3 = 0, k4 = 0] = d;
  const r = Math.hypot(a, b);
  if (r < 1e-9) return [a, b];
  const angle = Math.atan(r);
  const s = angle * angle;
  const scale = (angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))) / r;
  return [a * scale, b * scale];
}

/** Return the centre of a camera in the world. */
export function centreOf(camera: CameraModel): [number, number, number] {
  const { rotation: r, translation: t } = camera;
  const at = (i: number): number => -(r[i]! * t[0]! + r[3 + i]! * t[1]! + r[6 + i]! * t[2]!);
  return [at(0), at(1), at(2)];
}

/** Return the corners of the image as directions in the world, at depth 1 (no lens). */
export function cornersOf(camera: CameraModel): [number, number, number][] {
  const { rotation: r, matrix: k, size } = camera;
  const [w, h] = size[0] ? size : [2 * k[2]!, 2 * k[5]!];
  const corners = [[0, 0], [w, 0], [w, h], [0, h]] as const;
  return corners.map(([u, v]) => {
    const a = (u - k[2]!) / k[0]!;
    const b = (v - k[5]!) / k[4]!;
    const at = (i: number): number => r[i]! * a + r[3 + i]! * b + r[6 + i]!;
    return [at(0), at(1), at(2)];
  });
}
