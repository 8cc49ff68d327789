/** The parts of run.json that the page reads by name; docs/run-json.md describes all. */

export type Json = null | boolean | number | string | Json[] | { [key: string]: Json };

export interface Spread {
  median: number;
  p95: number;
}

export interface Check {
  name: string;
  value: number | null;
  limit: number;
  camera: string | null;
  passed: boolean;
}

export interface RunCamera {
  name: string;
  weak: boolean;
  weak_perspective: boolean;
  faults: string[];
  fault_evidence: Record<string, Record<string, Json>>;
  intrinsics: { source: string };
  clock: { subframe_offset: number | null; sigma: number | null; used: boolean };
}

export interface RunPair {
  a: string;
  b: string;
  breaks_loop: boolean;
  source: string;
  alternatives: unknown[];
}

export interface RunClock {
  camera: string;
  kind: string;
  applied: boolean;
}

export interface Run {
  version: string;
  model: string;
  solver?: string;
  unit: string;
  keypoints: string[];
  left_out: string[];
  verdict: { rig: string; reasons: string[]; checks: Check[]; reversal: string; translation: string };
  world: { kind: string; remarks: string[]; camera: string | null };
  groups: { folder: string; cameras: string[] }[];
  clocks: RunClock[];
  epochs: { folder: string; first: number; last: number; moved: string[] }[];
  unused_pairs: { a: string; b: string }[];
  cameras: RunCamera[];
  pairs: RunPair[];
  individuals: { individual: number; frames: number; cameras: Record<string, number> }[];
  config: Record<string, Json>;
}

/** Return the faults of a camera that were not mended for the run. */
export function openFaults(camera: RunCamera): string[] {
  return camera.faults.filter((word) => !camera.fault_evidence[word]?.mended);
}
