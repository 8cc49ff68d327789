"""Every default, once. Imports nothing heavy, so that the command line can show them."""

from dataclasses import dataclass
from math import radians
from typing import Literal, get_args

# nats, odds of 20 to 1: evidence from which on a hypothesis about a camera is accepted, of any kind
DECISIVE_NATS = 3.0

SMALL_RIG = 17  # cameras: of up to so many nearly all see the same bodies

LIFT_CONFIDENCE = 0.4  # of a view's best confidence: joints below it are hidden from the network
LIFT_BEST_PERCENTILE = 90.0  # of a view's confidences: the view's best
LIFT_LEAST_DEPTH = 0.5  # body sizes: no body is nearer to a camera

ENCODER_HEADS = 4  # of the networks' encoders, which share a token

SmoothMode = Literal["auto", "bones", "off"]  # what is done to poses; the first is the default
SMOOTH_MODES: tuple[SmoothMode, ...] = get_args(SmoothMode)


@dataclass(frozen=True)
class SampleConfig:
    """The frames that calibration looks at.

    So many detections in all views together, within bounds on the frames.
    """

    detections: int = 10_000
    frames: int = 500  # at most: of one subject there are not more postures
    least_frames: int = 100
    candidates: int = 4  # frames looked at for each that is taken
    cells: int = 6  # of an image, along each side
    # frames with several times the usual number of detections are left out
    usual_share: float = 0.9  # of the frames have no more than the usual number
    crowd: int = 2  # so many times the usual number, and so many more


# what is done about clocks that differ: found and mended, found and said, or not looked at
SyncMode = Literal["auto", "check", "off"]
SYNC_MODES: tuple[SyncMode, ...] = get_args(SyncMode)
# frames of one camera for a frame of another: ratios of the rates that cameras have
CLOCK_RATES = (1.0, 1 / 2, 2.0, 1 / 3, 3.0, 1 / 4, 4.0, 2 / 3, 3 / 2, 5 / 6, 6 / 5)


@dataclass(frozen=True)
class SyncConfig:
    """How the clocks of the cameras are compared.

    mode: one of `SYNC_MODES`.
    window: frames by which a camera may be early or late.
    rates: cameras whose frame rates are known to be others: (name, frames of this camera for one
        of the others).
    subframe: whether offsets of parts of a frame are estimated and applied.
    """

    mode: SyncMode = "auto"
    window: int = 60
    rates: tuple[tuple[str, float], ...] = ()
    subframe: bool = True


@dataclass(frozen=True)
class PairwiseConfig:
    """Relative poses of pairs. Lengths in body sizes; image errors are measured at the body."""

    # what is looked at
    frames: int = 150  # evenly spread; the search does not get better with more
    all_frames: int = 12_000  # of all pairs together: in large rigs they say the same many times
    least_frames: int = 20
    least_joints: int = 3  # of a detection in a frame, and in common with another detection
    possible_matches: int = 6000  # in all frames; crowds get fewer frames
    # the search
    candidates_searched: int = 400  # rotations that are scored on all frames
    hypotheses_searched: int = 9  # the best of them, which are aligned; and of pairs of tracks
    hypotheses_refined: int = 3  # to the end: the answer and its alternatives
    separation_deg: float = 15.0  # between hypotheses
    # five-point RANSAC where identities are known
    five_point_draws: int = 3  # each with half the tolerance of the one before,
    five_point_matches: int = 60  # so many matches each, of one individual
    # affinity
    pose_tolerance: float = 0.35  # RMS joint distance of two lifts of one body ...
    pose_doubt: float = 2.5  # ... or this many times what the network expects, where that is more
    centre_tolerance: float = 0.15  # of the distance: how well one view tells how far a body is
    inlier: float = 0.08  # epipolar error of a good joint
    # refinement
    rounds: int = 2  # of matching and refining
    loss_widths: tuple[float, ...] = (4, 3, 2, 1.5, 1, 1, 1, 1)  # of each step, times `inlier`


LEAST_LIFT_SPREAD = 0.05  # body sizes: no lifted joint is more certain


# ways to calibrate a pair of views; the first is the default
PAIR_SOLVERS = ("search", "paper", "five-point")


# which pairs of cameras are calibrated; the first is the default
PairChoice = Literal["chosen", "all"]
PAIR_CHOICES: tuple[PairChoice, ...] = get_args(PairChoice)


@dataclass(frozen=True)
class ViewGraphConfig:
    """Which pairs of cameras are calibrated.

    pairs: one of `PAIR_CHOICES`.
    small_rig: of up to so many cameras all pairs are calibrated.

    What two views see in common, by the shapes of lifted bodies:
    frames: that are compared, and in how many shifts out of step.
    alike: share of the usual squared distance at which two shapes are alike.

    The first graph, of each camera:
    partners: that see most in common with it; and as many more, evenly spread over those with at
        least the share `likely` of what the best sees in common.

    Where the graph grows:
    least_confirmed_share: share of the pairs that close triangles; with a smaller one all pairs are
        calibrated. Measured in the first graph: 0.84 to 1 in halls and rings, at most 0.5 in a hall
        of 63 cameras where partners are drawn at random.
    A camera with fewer such pairs than `partners` gets so many more, twice as many in each round
        that follows, and so do two parts that fewer join. rounds: at most.
    """

    pairs: PairChoice = "chosen"
    small_rig: int = SMALL_RIG
    frames: int = 60
    shifts: int = 4
    alike: float = 0.05
    partners: int = 5
    likely: float = 0.4
    least_confirmed_share: float = 0.6
    rounds: int = 3


@dataclass(frozen=True)
class AveragingConfig:
    """From the pairs to groups of cameras, and to a rig.

    least_score: a pair below it is not used; a camera that has only such pairs is left out.
    weak_score: below it the user is warned. Simulated views of different times reach 0.60, views
        of one time 0.84 and more.
    scale_deg: a pair this far from the rig keeps a quarter of its weight, and one that keeps less
        contradicts the others. So does a pair whose baseline is off by twice this angle.
    contradicted_share: two groups that are certain without each other are joined by no strong pair
        that closes less of its triangles, of at least `enough_triangles`; and by no other
        where all pairs between them together close less. Measured in a hall of 64 cameras: right
        pairs between two groups close 0.5 and more, wrong ones up to 0.2.
    iterations: of reweighting, here and of the height of a floor.
    """

    least_score: float = 0.12
    weak_score: float = 0.62
    scale_deg: float = 4.0
    contradicted_share: float = 0.25
    enough_triangles: int = 5
    iterations: int = 30

    @property
    def translation_scale(self) -> float:
        """The scale of translations, as a share of the baseline."""
        return 2 * radians(self.scale_deg)


@dataclass(frozen=True)
class MatchingConfig:
    """Identities: in a frame, and through the whole recording.

    least_affinity: 0..1, the mean affinity down to which two groups of detections are joined.
    individuals: how many there are at most; None = not known.
    decisive: evidence in nats that leaves no doubt: how much likelier a group's place in the next
        frame must be than any other, and how unlikely it may be itself. Twice this much against it
        leaves two that are never seen together one individual, for a recording has as few
        individuals as it needs.
    most_pieces: that are joined at once; parts of longer recordings are joined by themselves.
    """

    least_affinity: float = 0.25
    individuals: int | None = None
    decisive: float = 2 * DECISIVE_NATS
    most_pieces: int = 500


@dataclass(frozen=True)
class AdjustConfig:
    """Bundle adjustment. Loss scales are in standard deviations of each view's own residuals."""

    points: int = 20_000
    # Standard deviations beyond which a ray does not constrain a point. Far more than an outlier of
    # triangulation: the rig is not yet right, and the robust loss deals with outliers.
    outlier: float = 20.0
    # One after the other, to tighten the loss, until the errors of the recording ask for no
    # narrower one: the first is for starts alone.
    loss_scales: tuple[float, ...] = (6.0, 3.0, 1.5)
    # Share of the cost: a step of the cameras that promises to lower it by less is the last one at
    # the last loss scale ...
    tolerance: float = 1e-5
    rough_tolerance: float = 1e-3  # ... and at those before, which need not be minimised to the end
    # This share of each view's detections, the least confident, is left out of the adjustment, as
    # long as `enough_detections` of the view are left.
    low_confidence_share: float = 0.3
    enough_detections: int = 1000
    least_keypoints: int = 12  # a camera is constrained by: twice what would do without any noise
    rounds: int = 6  # of adjusting and matching; they end when ...
    still_deg: float = 0.05  # ... no camera turns by more than this


# what of the intrinsics may be estimated
Refinement = Literal["none", "focal", "focal+k1"]
REFINEMENTS: tuple[Refinement, ...] = get_args(Refinement)
# ... where nobody knows them, if nothing else is said
ASSUMED_REFINEMENT: Refinement = "focal+k1"


@dataclass(frozen=True)
class IntrinsicsConfig:
    """Which intrinsics are estimated from the recording, and what is known of them beforehand.

    refine: one of `REFINEMENTS`.
    focal_uncertainty: standard deviation of the logarithm of the given focal lengths: 0.05 where
        they are good to 5 %. Video cameras have 0.5 to 2 image widths, half or twice what is
        assumed where nothing is given.
    focal_per_camera: cameras of equal image size have focal lengths of their own; else all that is
        said of one holds for the others.
    least_gain: share of the uncertainty that an estimate may leave: where more is left, the
        recording does not determine the focal lengths, and they stay as given.
    k1_uncertainty: standard deviation of the first coefficient of the lens.
    significance: standard deviations, root mean square over the cameras, by which focal lengths
        that are free must be away from the one that cameras of equal image size share: each has its
        own then. Measured: 0.7 to 1.3 where they are equal, 2.0 where clocks and keypoints are poor
        besides; 3.3 to 20 where they differ by 8 to 20 %. And by which k1 of a camera must be away
        from what was given, to be changed.
    overconfidence: by how much the variance is larger than that of independent errors, until it
        has been measured. Real recordings have 2 to 100.
    """

    refine: Refinement = "none"
    focal_uncertainty: float = 0.5
    focal_per_camera: bool = False
    least_gain: float = 0.5
    k1_uncertainty: float = 0.2
    significance: float = 3.0
    overconfidence: float = 25.0


DEFAULT_FOCAL = 1.2  # focal length of a camera of which nothing is known, in longer image sides
SAME_IMAGE_SIZE = 0.01  # videos of one kind of camera may lack some rows


@dataclass(frozen=True)
class TriangulateConfig:
    """3D poses. Errors in standard deviations of each view's own error."""

    # Standard deviations of what points leave of the errors, sqrt(1 - 3 / (2 V)) of V rays. Of 3 to
    # 5, as measured on 13 recordings, 4 gives the smallest errors of the bodies; 5 has 1 % of
    # points more, which are worse. And of a given focal length, from which on it is wrong.
    outlier: float = 4.0
    least_angle_deg: float = 2.0  # between the rays of a point
    noise_frames: int = 200  # that tell how large each view's error is
    unknown_noise: float = 0.01  # radians: error of a keypoint before anything is known of it
    least_noise_px: float = 0.25


@dataclass(frozen=True)
class PosesConfig:
    """Best estimates of poses (`poses/`). Lengths in body sizes, times in steps between frames.

    smooth: "auto"; "bones" alone, nothing over time; "off": the triangulated points.
    losses: of angles between rays and points, in standard deviations, among which held-out
        detections choose, the usual one first. Chosen: the narrow one for most detectors, where it
        would cost projected recordings 2 to 3 %; the wide one for normal errors (HumanEva -2.7 %,
        mice -1.3 %).
    prior_loss: of accelerations and of bones: most are small, some large. Measured on ten
        recordings: with 3 errors change by +5 % of HumanEva, +2.5 % of two dogs, at most 1 % of the
        others.
    shared_acceleration: variance of the acceleration that a body's joints share, to that of theirs
        around it. Measured: 0.1 to 0.5 differ by at most 0.5 % (HumanEva 2 %).
    accelerations: standard deviations among which, and none, held-out detections choose, the
        largest first. Chosen: 0.2 to 0.006 of motions at 10 to 60 frames a second. Where points
        accelerate by more than the largest (0.01 to 0.1 in motions, 0.7 and more elsewhere), frames
        do not follow each other.
    bones: standard deviations of lengths, beyond what they were measured to vary by, among which
        they choose then. Chosen: the first in nine recordings, the second for simulated people.
        Twice the first costs two dogs 9 %, and others up to 1 %.
    held_out_stretch: frames of bodies, in four of which they choose.
    steps: of Gauss-Newton, twice as many to fit points as to choose strengths, and to fit points
        again without the detections that the first fit drops. In each, half as many of conjugate
        gradients; by a quarter, another strength is chosen for two dogs: errors rise by 7 %.
    ridge: inverse variance of a point before anything is known of it, which damps the steps.
    longest_gap: frames without any detection of a joint that are bridged.
    largest_sigma: of a point; what is less sure is missing.
    """

    smooth: SmoothMode = "auto"
    losses: tuple[float, ...] = (2.5, 4.0, 1.5)
    prior_loss: float = 2.0
    shared_acceleration: float = 0.25
    accelerations: tuple[float, ...] = tuple(0.2 / 2**k for k in range(6))
    bones: tuple[float, ...] = (0.012, 0.05)
    held_out_stretch: int = 50
    steps: int = 4
    ridge: float = 1e-2
    longest_gap: int = 10
    largest_sigma: float = 0.15


# rotation errors of the least certain camera, in degrees, below which 95 % lie: below the first a
# rig is well determined, below the second usable, below the third weak
VERDICT_LIMITS_DEG = (1.0, 3.0, 10.0)
OF_95_PERCENT = 1.6  # root of the 95 % quantile of chi-square with 3 degrees of freedom, over 3
# expected error of a well determined rig, at most
SOUND_DEG = VERDICT_LIMITS_DEG[0] / OF_95_PERCENT


@dataclass(frozen=True)
class UncertaintyConfig:
    """Whether a recording determines its rig, and whether all cameras agree on it."""

    # stretches of the recording within which errors go together; fewer frames accuse no camera: of
    # 3 to 10 frames of a sound rig two focal lengths were "wrong"
    time_blocks: int = 20
    points: int = 2500  # that the covariance of a rig is found with
    parts: int = 5  # of the recording, that a rig is adjusted without
    # By how much more rigs without a part differ than first order tells: 0.8 to 1.7 in recordings
    # that determine their rigs, where it is chance; 2.0 in two that barely do.
    usual_bend: float = 1.5
    # Where the principal point is, from the middle of the image, in longer sides of it: a standard
    # deviation of each coordinate. Measured on 15 recordings: 0 to 4.8 %, root mean square 1.8 %.
    principal_point: float = 0.018
    # The same of a given principal point, as calibrations by a board leave it. No residual shows
    # more: of HumanEva's three cameras one may be off by 8 % (4 degrees) with equal errors.
    given_principal_point: float = 0.005
    # One that is far from the middle may be that of other images, cropped or resized since: a share
    # of all, and their standard deviation beside that of lenses (5 % and more in 4 of 22 rigs).
    # Where a user states how well it is known, in longer sides of the image, neither counts.
    mistaken_share: float = 0.04
    mistaken_principal_point: float = 0.1
    usual_principal_point: float = 0.025
    centre_uncertainty: float | None = None
    # An outlier camera has so many times the errors of the others, and half as many those of the
    # best quarter. Measured: 1 to 2.6 where the cameras agree, 3.8 between telescopes, 5 to 18
    # where one is out of step. No error counts for more in the misfit of a rig.
    outlier_factor: float = 4.0
    # Errors beyond sigma, which the cameras of real rigs share: up to 3.5 % of shelf.
    focal_systematic: float = 0.02
    focal_uncertainty: float | None = None  # as a user states it, a share of each focal length
    tied_misfit: float = 1.001  # ratio of misfits that differ by where an adjustment ended alone
    same_misfit: float = 1.05  # ratio of the misfits of two rigs that fit equally well


@dataclass(frozen=True)
class ResectionConfig:
    """The search for the projection of one camera from points that others know.

    tolerance: at which a joint costs half, in median distances of image points from their middle.
    """

    hypotheses: int = 300
    frames: int = 2  # of a hypothesis
    frames_scored: int = 60
    hypotheses_refined: int = 6
    tolerance: float = 0.1
    rounds: int = 8


@dataclass(frozen=True)
class CameraFitConfig:
    """A camera fitted to known points. Loss scales are in standard deviations."""

    loss_scales: tuple[float, ...] = (4.0, 2.0, 1.0)
    steps: int = 30  # at each loss scale, at most


@dataclass(frozen=True)
class DiagnosisConfig:
    """Which camera's input is wrong, and how.

    A gain is what a hypothesis lowers the robust cost of a keypoint by, on average; evidence is in
    nats, against the input as given.

    sound_focal, sound_centre: standard deviations of the intrinsics of sound cameras, of the
        logarithm of the focal length and of the principal point in image sizes. Shelf, which is
        sound, asks for 0.05 and 0.07. faulty_focal, faulty_centre: those of faulty ones.
    upright_nats: evidence of a camera that lies on its side, beside upright ones, that its images
        are rotated. upright_deg: that upright cameras roll at most.
    exchanged_share: of the detections, whose sides are exchanged, from which on that is named.
    frames, keypoints: that a camera is held against in its leave-one-out rig; candidates: cameras
        that are.
    focal_noise: error of a keypoint, roughly, in focal lengths.
    least_keypoints: that a camera is held against at all. least_matched: share of its detections;
        with a smaller one, of what is usual among the others, `verify` looks for it anew.
        Measured 0.45 and more where a camera is faulty, 0.05 where a rig of nearly affine cameras
        was accused.
    """

    resection: ResectionConfig = ResectionConfig()
    fit: CameraFitConfig = CameraFitConfig()
    sound_focal: float = 0.02
    sound_centre: float = 0.025
    faulty_focal: float = 0.4
    faulty_centre: float = 0.15
    upright_nats: float = 7.0
    upright_deg: float = 30.0
    exchanged_share: float = 0.25
    frames: int = TriangulateConfig.noise_frames
    keypoints: int = 4000
    candidates: int = 5
    focal_noise: float = 0.005
    least_keypoints: int = 100
    least_matched: float = 0.25


# of resized images
PLAIN_FACTORS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)


@dataclass(frozen=True)
class MovedConfig:
    """Whether a camera was bumped or moved during the recording (faults/moved.py).

    detections: of one camera, about, by which it is judged.
    stretches: of time, each of which may have a pose of its own; least_detections: of a stretch.
    loose: tolerance of an error, in RMS angular sizes of a detection: wider than what a bump of a
        few degrees makes, so that both epochs still count.
    tolerance_noises: of an error, in standard deviations, in the end.
    steps: of Gauss and Newton, down to a tenth of the widest tolerance.
    most_changes: that are looked for in one camera.
    least_angle_deg, and least_shift in sizes of the rig: a change below both is none: clocks that
        differ by a part of a frame look like 0.1 deg and 0.004.
    """

    detections: int = 300
    stretches: int = 25
    least_detections: int = 12
    loose: float = 0.3
    tolerance_noises: float = 3.0
    steps: int = 6
    most_changes: int = 3
    least_angle_deg: float = 0.5
    least_shift: float = 0.01


@dataclass(frozen=True)
class MendConfig:
    """What is done where the input of a camera is wrong.

    apply: it is corrected for this run; else it is only named.
    """

    apply: bool = True


MENDING = ("auto", "none")  # whether faults are mended; the first is the default
EPOCH_MARK = "@"  # between the name of a camera and the frame from which on it stands elsewhere
REPORT_FRAMES = 2000  # whose reprojection errors run.json tells
RIG_ERROR_THRESHOLDS_DEG = (5, 10, 20, 30)  # at which `evaluate` tells the accuracy


@dataclass(frozen=True)
class KinematicsConfig:
    """Contacts of feet with the floor; lengths in lengths of a leg (hip to ankle).

    Looked at on motion capture (walkers of Human3.6M and HumanEva at 10 and 12 frames per second,
    rates that their pace suggests; two dogs, taken for 30) and on simulated people at 30, without
    and with 20 mm of noise: from 0.06 to 0.1 of height the shares of contacts grow by up to 0.05,
    from 0.6 to 1 of speed by up to 0.07 for people and 0.12 for dogs. Nobody measured contacts.
    """

    contact_height: float = 0.08
    contact_speed: float = 0.8  # legs per second
    rest_quantile: float = 0.1  # of a joint's heights: what it has on a foot that stands
    window: float = 0.05  # seconds before and behind, in which heights and speeds are averaged


@dataclass(frozen=True)
class FloorConfig:
    """How the floor below bodies is estimated. Lengths in body sizes (`geometry.body_size`).

    Measured on 15 recordings against the references' axes: people who walk 0.6 to 1.5 deg, which
    the references' own ankles are off by too (0.4 to 1.7); dogs 0.4, mice 0.5.

    near: feet this far from the plane are not on the floor, and feet this near each other are in
        one place.
    sigma: of the height of feet in one place, and of soles over the floor; and of the axis of
        people on straight legs, in radians. Twice that height of animals and of people who do not
        stand (of three who sit the plane is 4 to 6 deg off), and four times that axis. Measured:
        axes 0.9 to 3.9 deg off; 14 deg of people who sit, 3 to 15 deg of animals. No floor has feet
        whose heights spread by more: up to 0.05 on floors; 0.08 and more of simulated rats that
        rear, 0.13 of a cheetah on a slope. Nor an up direction that is less sure than twice of it.
    straight: share of its length that a leg which stands has (walkers 0.97, seated people 0.7).
    up_sigma: in radians, of each of two directions, however many feet were seen.
    ankle_height: of ankles over the sole, in lengths of the leg.
    """

    near: float = 0.5
    sigma: float = 0.06
    straight: float = 0.93
    up_sigma: float = 0.01
    ankle_height: float = 0.12


CueKind = Literal["height", "length", "camera distance"]
WORLDS = ("auto", "floor", "first-camera")  # that are asked for by a word; else a camera's name


@dataclass(frozen=True)
class ScaleCue:
    """A known length.

    kind: "height" of an individual who stands, "length" between two joints, "camera distance"
        between two cameras.
    metres: it, and sigma: its standard deviation in metres, 0 = exactly known.
    of: the individual ("0", or a name; "" = whoever stands), two joints ("left_hip-left_knee"), or
        two cameras ("A-B").
    """

    kind: CueKind
    metres: float
    sigma: float = 0.0
    of: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.metres < float("inf") or not 0 <= self.sigma < self.metres:
            raise ValueError(
                f"{self.kind}: expected metres above 0, and a sigma below them, "
                f"got {self.metres:g} +- {self.sigma:g}"
            )


@dataclass(frozen=True)
class KnownCamera:
    """The pose of a camera in a known world.

    rotation: nine numbers, row by row, and translation: three, of cam_from_world.
    """

    name: str
    rotation: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True)
class Landmark:
    """A point of known place, as a camera sees it.

    position: x, y, z in metres. pixel: u, v; integers are the middles of pixels.
    """

    name: str
    position: tuple[float, float, float]
    camera: str
    pixel: tuple[float, float]


@dataclass(frozen=True)
class CueConfig:
    """How known lengths are measured.

    head_height: of a point of the head over the floor, in statures. Measured against the heads of
        the references: head_top 1.00 to 1.06, eyes 0.94 to 0.98. Beside anatomy (Drillis and
        Contini 1966: eyes at 0.936 statures, the vertex at 1, ankles at 0.039, hips at 0.530):
        from the ankle, 0.12 legs over the sole here, eyes are at 0.891 statures for 0.897, the
        top of the head at 0.971 for 0.961.
    height_sigma: relative, of a stature, however many frames there are, and half of that of a
        length between joints: detectors place joints beside those of anatomy (bones of people -16
        to +12 %, statures -3 to +3 %).
    statures: of people in metres, least and most.
    """

    head_height: tuple[tuple[str, float], ...] = (
        ("head_top", 1.03),
        ("left_eye", 0.950),
        ("right_eye", 0.950),
        ("left_ear", 0.945),
        ("right_ear", 0.945),
        ("nose", 0.930),
    )
    height_sigma: float = 0.03
    statures: tuple[float, float] = (0.3, 3.0)


@dataclass(frozen=True)
class WorldConfig:
    """The coordinates of results.

    axes: one of WORLDS, or the name of a camera. "auto": the floor where it is determined, else
        the first camera.
    cues: known lengths. forward: two joints ("left_hip-nose"); y points from the first to the
        second. "" = as the first camera looks.
    cameras: poses of cameras in a known world, to which results are aligned; unit: of their
        lengths. landmarks: points of a known world, to which results are aligned.
    stated_sigma: of places of landmarks and cameras, as a share of their RMS distance from their
        middle: 2 cm in a room of 4 m; and of the axes of cameras, in radians. landmark_pixels: of a
        landmark in an image.
    most_misfit: in standard deviations, above which known lengths contradict each other; and of
        these errors and of the rig, above which a world is refused: references of rigs that are
        usable have 0.03 to 1.4, landmarks measured to 1 % up to 1.5, a landmark of five that is
        wrong by it 7 to 30, exchanged axes and made-up cameras 10 to 170.
    """

    axes: str = "auto"
    cues: tuple[ScaleCue, ...] = ()
    forward: str = ""
    cameras: tuple[KnownCamera, ...] = ()
    unit: str = "arbitrary"
    landmarks: tuple[Landmark, ...] = ()
    floor: FloorConfig = FloorConfig()
    measure: CueConfig = CueConfig()
    stated_sigma: float = 0.01
    landmark_pixels: float = 2.0
    most_misfit: float = IntrinsicsConfig.significance

    @property
    def stated_unit(self) -> str:
        """The unit that the lengths of results will have, "arbitrary" where nothing says one."""
        return "m" if self.cues or self.landmarks else self.unit


@dataclass(frozen=True)
class Config:
    """All stages."""

    sample: SampleConfig = SampleConfig()
    sync: SyncConfig = SyncConfig()
    pairwise: PairwiseConfig = PairwiseConfig()
    view_graph: ViewGraphConfig = ViewGraphConfig()
    averaging: AveragingConfig = AveragingConfig()
    matching: MatchingConfig = MatchingConfig()
    adjust: AdjustConfig = AdjustConfig()
    intrinsics: IntrinsicsConfig = IntrinsicsConfig()
    triangulate: TriangulateConfig = TriangulateConfig()
    poses: PosesConfig = PosesConfig()
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    moved: MovedConfig = MovedConfig()
    diagnosis: DiagnosisConfig = DiagnosisConfig()
    mend: MendConfig = MendConfig()
    world: WorldConfig = WorldConfig()


FilterMethod = Literal["butterworth", "median", "savgol"]
FILTER_METHODS: tuple[FilterMethod, ...] = get_args(FilterMethod)


@dataclass(frozen=True)
class FilterConfig:
    """A classic filter over time (`poses/filters.py`), which only the command `filter` uses.

    order, cutoff: of the Butterworth filter, both runs together, in Hz. The usual ones for people
        who walk. window: of the others, in frames, odd. polynomial: order of Savitzky-Golay's.
    """

    method: FilterMethod = "butterworth"
    order: int = 4
    cutoff: float = 6.0
    window: int = 7
    polynomial: int = 3


# Positions in files, in sizes of the image: no larger than the first they are shares of it, not
# pixels, and larger ones are of another image; below the second they are on another scale
LARGEST_SHARE = 1.5
LEAST_SHARE = -0.25
FAR_OUTSIDE = 3.0  # sizes of the image beyond its border: a detector cannot mean such a position

# When two files have the same detections (recording/synchronise.py). In the shared recordings no
# detection of one camera was within a pixel of another camera's in all its keypoints.
COPY_TOLERANCE = 2e-5  # of coordinates, as a share of the largest: files keep three decimals
COPY_FEW = 20  # distinct detections, and others of one mean that one is compared with
COPY_COMPARED = 200  # detections at most, evenly spread
COPY_SHARE = 0.9  # of these, that must be in the other file at one shift

# Files and cameras that make a recording (recording/synchronise.py)
LEAST_JOINTS = 4  # that show how a body is turned
CROWDED_SHARE = 0.2  # of images with several detections; where fewer have, those are false ones
# percentile that stands for the largest value, so that one wild point does not count
TYPICAL_PERCENTILE = 99.0

# Lenses and two views (geometry/lens.py, geometry/epipolar.py)
LENS_MISS_PX = 0.5  # between a pixel and its ray's: beyond, the lens model has no ray for it
FIVE_POINT_LEAST_RAYS = 8  # that RANSAC is tried on
LEAST_FORWARD = 0.1  # cosine of a ray with the axis of a plane; others have no image point
FIVE_POINT_CONFIDENCE = 0.999  # of RANSAC

# Points from the rays of many views (geometry/intersection.py); scales in standard deviations
INTERSECT_STEPS = 2  # after the closed form: the third moves a point by 1e-9 of its distance
INTERSECT_LOSS_SCALE = 3.0
# of the loss, among outliers
INTERSECT_TIGHTENING_SCALES = tuple(k * INTERSECT_LOSS_SCALE for k in (8, 4, 2, 1, 1, 1))
INTERSECT_OUTLIER = TriangulateConfig.outlier**2  # squared error: rays beyond do not belong
# squared error for each of the rays, from which on a point starts again: of few rays a wrong one
# bends the point to itself
INTERSECT_DOUBTFUL = 4 / 3
INTERSECT_AGREEING_RAYS = 3  # that must meet, and half of all, for the rest to be outliers

# COLMAP and nerfstudio have (0, 0) at the corner of the first pixel, we have it at its centre
CORNER_OFFSET = 0.5
