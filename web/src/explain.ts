/** What each number of run.json means; docs/run-json.md and docs/how-good.md have the same at length. */

export interface Explanation {
  label: string;
  text: string;
  unit?: string;
  /** What sound recordings show. */
  sound?: string;
}

const e = (label: string, text: string, unit?: string, sound?: string): Explanation => ({
  label,
  text,
  ...(unit ? { unit } : {}),
  ...(sound ? { sound } : {}),
});

const TURN = "By how much a camera may be turned from its true rotation, one standard deviation, "
  + "after the rig was laid on the true one as well as can be.";
const SHIFT = "By how far a camera's centre may be off, one standard deviation, in percent of the "
  + "size of the rig (distance of the cameras from their middle).";
const INTRINSICS = "The part of the rotation's uncertainty that intrinsics stand for: what the rig "
  + "changes by when focal lengths are free, beyond chance; what estimated ones may be off by.";
const REPROJECTION = "Distance in the image between a detection and the 3D point it belongs to. "
  + "A low error alone proves nothing.";
const SCORE = "Share of the detections that are explained, times the share of joints in front of "
  + "both cameras, times how well the lifted bodies agree.";
const GOOD_SCORE = "0.7 and more; below 0.62 a camera is called weak";
const SETTLED = "below 1° is well determined, below 3° usable, below 10° weak";

/** By path within run.json; `*` stands for a number or a name. */
const EXPLANATIONS: Record<string, Explanation> = {
  "verdict.expected_error_deg": e("Expected error of the worst camera", "The root of the sum of the squares of its causes. The verdict rests on this number.", "°", SETTLED),
  "verdict.rotation_sigma_deg.max": e("Rotation of the worst camera", `${TURN} It is one cause of the expected error.`, "°"),
  "verdict.rotation_sigma_deg.median": e("Rotation of the usual camera", TURN, "°"),
  "verdict.centre_sigma_percent.max": e("Place of the worst camera", SHIFT, "%"),
  "verdict.centre_sigma_percent.median": e("Place of the usual camera", SHIFT, "%"),
  "verdict.intrinsics_turn_deg.max": e("Intrinsics, worst camera", INTRINSICS, "°"),
  "verdict.intrinsics_turn_deg.median": e("Intrinsics, usual camera", INTRINSICS, "°"),
  "verdict.checks.*.value": e("What was found", "Each check looks at what the model leaves over, in a way that is independent of the stated uncertainty."),
  "verdict.checks.*.limit": e("Limit", "Up to this value sound recordings go. A check above it makes a rig usable at best."),
  "frames.count": e("Frames", "Frames that two cameras or more have.", "frames"),
  "frames.first": e("First frame", "The first frame that two cameras have."),
  "frames.last": e("Last frame", "The last frame that two cameras have."),
  "points.triangulated": e("3D points", "Joints that were triangulated, over all frames.", "points"),
  "points.reprojection_error_px.median": e("Reprojection error", `${REPROJECTION} Median over the points.`, "px"),
  "points.reprojection_error_px.p95": e("Reprojection error, 95 %", `${REPROJECTION} 95 of 100 points are better than this.`, "px"),
  "points.mean_error_px": e("Mean error", "Median over the points of the mean error over the cameras: what anipose calls error.", "px"),
  "cameras.*.frames": e("Frames", "Frames in which the camera has a detection.", "frames"),
  "cameras.*.detections": e("Detections", "Bodies that were detected, in all frames."),
  "cameras.*.matched": e("Matched", "Detections that have an individual: another camera confirms them."),
  "cameras.*.unmatched": e("Unmatched", "Detections that no other camera confirms.", undefined, "0 to 0.13 of the detections"),
  "cameras.*.pair_score": e("Pair score", `Score of the camera's best pair. ${SCORE}`, undefined, GOOD_SCORE),
  "cameras.*.rotation_sigma_deg": e("Rotation uncertainty", TURN, "°", SETTLED),
  "cameras.*.centre_sigma_percent": e("Place uncertainty", SHIFT, "%"),
  "cameras.*.centre_sigma": e("Place uncertainty as a length", "By how far the camera's centre may be off, one standard deviation; not known where lengths are arbitrary."),
  "cameras.*.intrinsics_turn_deg": e("Intrinsics' part", INTRINSICS, "°"),
  "cameras.*.reprojection_error_px.median": e("Reprojection error", `${REPROJECTION} Median of this camera's detections.`, "px"),
  "cameras.*.reprojection_error_px.p95": e("Reprojection error, 95 %", `${REPROJECTION} 95 of 100 are better than this.`, "px"),
  "cameras.*.clock.subframe_offset": e("Part of a frame", "What part of a frame this camera's clock is ahead or behind the first camera's; not known where the motion does not tell.", "frames"),
  "cameras.*.clock.sigma": e("Its uncertainty", "Standard deviation of the part of a frame.", "frames"),
  "cameras.*.intrinsics.focal_px": e("Focal length", "Mean focal length of the lens.", "px"),
  "cameras.*.intrinsics.focal_sigma_px": e("Its uncertainty", "Standard deviation of the focal length; not known where it was given.", "px"),
  "cameras.*.intrinsics.k1": e("Lens k1", "First coefficient of the lens distortion."),
  "cameras.*.intrinsics.k1_sigma": e("Its uncertainty", "Standard deviation of k1; not known where it was given."),
  "cameras.*.intrinsics.focal_change": e("Focal change", "By what share the given focal length would change if it were free.", undefined, "below 0.03"),
  "cameras.*.intrinsics.focal_change_sigma": e("Its uncertainty", "Standard deviation of the focal change."),
  "cameras.*.fault_evidence.*.*": e("Evidence", "A number that the fault rests on; the table of faults in docs/run-json.md says what is usual."),
  "clocks.*.offset_frames": e("Clock offset", "What this camera's frame numbers have too much: 5 where it is 5 frames late.", "frames", "0"),
  "clocks.*.rate": e("Frame rate", "Frames of this camera for one frame of the common clock.", undefined, "1"),
  "clocks.*.evidence.*": e("Evidence of the clock", "How well the lifted bodies agree with those of other cameras at this clock.", undefined, "a score of 1.4 and more"),
  "pairs.*.score": e("Pair score", SCORE, undefined, "0.7 and more; below 0.12 a pair is not used"),
  "pairs.*.frames": e("Frames", "Frames that both cameras share, of those looked at."),
  "pairs.*.matches": e("Matches", "Detections of the two cameras that are the same individual in the same frame."),
  "pairs.*.reprojection_error_px.median": e("Reprojection error", `${REPROJECTION} Median of the points that both see.`, "px"),
  "pairs.*.reprojection_error_px.p95": e("Reprojection error, 95 %", `${REPROJECTION} Of the points that both see.`, "px"),
  "pairs.*.rotation_sigma_deg": e("Rotation uncertainty", "Standard deviation of the rotation between the two, in the final rig.", "°"),
  "pairs.*.sampled_matches": e("Sampled matches", "Matches that the pair found by itself."),
  "pairs.*.in_front": e("In front", "Share of the matched joints in front of both cameras.", undefined, "near 1"),
  "pairs.*.epipolar_error_deg": e("Epipolar error", "Median angle by which the rays of matched joints miss each other.", "°"),
  "pairs.*.epipolar_error_px": e("Epipolar error in pixels", "The same at the mean focal length of the two.", "px"),
  "pairs.*.baseline_body_sizes": e("Baseline", "Distance between the two cameras in sizes of a body (0.55 m for an adult)."),
  "pairs.*.loop_rotation_deg": e("Loop error, rotation", "Between the rotation that the pair found by itself and that of the rig.", "°"),
  "pairs.*.loop_translation_deg": e("Loop error, direction", "Between the two directions from one camera to the other.", "°"),
  "pairs.*.weight": e("Weight", "What the pair counted for in the rig. Below 0.25 it contradicts the others."),
  "pairs.*.alternatives.*.*": e("Other answer", "Another answer that the pair had: its score, and how far it is turned."),
  "unused_pairs.*.score": e("Pair score", "Of two cameras that are not in one group. Views of different rooms reach 0.1 to 0.5."),
  "individuals.*.individual": e("Individual", "Its number in matches.csv."),
  "individuals.*.frames": e("Frames", "In how many frames it was matched."),
  "individuals.*.cameras.*": e("Frames of a camera", "In how many frames this camera's detections of it were matched."),
  "poses.triangulated": e("Triangulated", "Positions made of two views or more.", "points"),
  "poses.one_view": e("From one view", "Positions made of one view, the bones and the motion.", "points"),
  "poses.model": e("From the model", "Positions of a lifted body.", "points"),
  "poses.interpolated": e("Interpolated", "Positions in short gaps, where no view saw the joint.", "points"),
  "poses.outliers": e("Outliers", "Detections that were dropped since they are far from the estimates."),
  "poses.acceleration_sigma": e("Acceleration allowed", "Standard deviation of accelerations that was allowed, in body sizes per squared frame; not known: nothing was smoothed."),
  "poses.bone_sigma": e("Bone change allowed", "Standard deviation of the lengths of bones that was allowed, in body sizes."),
  "poses.held_out_error": e("Held-out error", "How badly detections that were not shown are predicted, in standard deviations."),
  "poses.held_out_error_raw": e("Held-out error, not smoothed", "The same without smoothing: it should be the larger one."),
  "world.up_sigma_deg": e("Uncertainty of up", "Standard deviation of the direction against gravity.", "°"),
  "world.up.*": e("Up", "Unit vector against gravity."),
  "world.floor.*": e("Floor", "A point of the floor."),
  "world.floor_sigma": e("Uncertainty of the floor", "Standard deviation of its height."),
  "world.scale_sigma_percent": e("Uncertainty of the scale", "Standard deviation of all lengths together; not known where they are arbitrary.", "%"),
  "world.cues.*.*": e("Known length", "A length that was stated, and what it is by all cues together."),
  "adjust.rounds": e("Rounds", "Rounds of adjusting and matching."),
  "adjust.turn_deg": e("Last turn", "By how much a camera turned in the last round, at most.", "°"),
  "epochs.*.*": e("Part of the recording", "Frames in which no camera was moved."),
  seed: e("Seed", "Of the random numbers. The same seed gives the same results."),
  schema: e("Schema", "Version of run.json."),
  "config.*": e("Setting", "A constant of the method; mocap_calib/config.py says what each means."),
};

const PATTERNS = Object.entries(EXPLANATIONS).map(
  ([pattern, explanation]) => [pattern.split("."), explanation] as const,
);

/** Return what a number means; names within a path may hold dots, so the path comes in parts. */
export function explain(path: readonly (string | number)[]): Explanation | null {
  for (const [pattern, explanation] of PATTERNS) {
    const open = pattern.length === 2 && pattern[1] === "*" && pattern[0] === path[0];
    if (!open && pattern.length !== path.length) continue;
    if (open || pattern.every((part, i) => part === "*" || part === String(path[i]))) return explanation;
  }
  return null;
}
