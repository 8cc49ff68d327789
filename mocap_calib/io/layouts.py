"""Name keypoints in the order in which programs write them, for files that hold numbers alone."""

from mocap_calib.errors import FormatError, MismatchError, argument, one_line, suggest

_COCO = (
    "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow "
    "right_elbow left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle "
    "right_ankle"
)
_ARMS = "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist"
_LEGS = "RHip RKnee RAnkle LHip LKnee LAnkle"
_HEAD = "REye LEye REar LEar"
_BODY_25B = (
    "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee "
    "RKnee LAnkle RAnkle UpperNeck HeadTop LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel"
)
_BODY_135_HANDS = " ".join(f"{side}Hand{k}" for side in "LR" for k in range(1, 21))
_BODY_135_FACE = " ".join(f"Face{k}" for k in range(70))
_HALPE = (
    f"{_COCO} head neck hip left_big_toe right_big_toe left_small_toe right_small_toe "
    "left_heel right_heel"
)
_FEET = " ".join(
    f"{side}_{part}" for side in ("left", "right") for part in ("big_toe", "small_toe", "heel")
)
_FACE = " ".join(f"face_{k}" for k in range(68))
_FINGERS = ("thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger")
_HAND = ("hand_root", *(f"{finger}{k}" for finger in _FINGERS for k in range(1, 5)))
_HANDS = " ".join(f"{side}_{part}" for side in ("left", "right") for part in _HAND)

_TEXTS = {
    "coco_17": _COCO,
    "body_25": f"{_ARMS} MidHip {_LEGS} {_HEAD} LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
    "body_25b": _BODY_25B,
    "body_135": f"{_BODY_25B} {_BODY_135_HANDS} {_BODY_135_FACE}",
    "coco_18": f"{_ARMS} {_LEGS} {_HEAD}",
    "mpi_15": f"{_ARMS.replace('Nose', 'Head')} {_LEGS} Chest",
    "halpe_26": _HALPE,
    "halpe_136": f"{_HALPE} {_FACE} {_HANDS}",
    "coco_wholebody_133": f"{_COCO} {_FEET} {_FACE} {_HANDS}",
    "h36m_17": (
        "pelvis right_hip right_knee right_ankle left_hip left_knee left_ankle spine thorax neck "
        "head left_shoulder left_elbow left_wrist right_shoulder right_elbow right_wrist"
    ),
    "mpii_16": (
        "right_ankle right_knee right_hip left_hip left_knee left_ankle pelvis thorax upper_neck "
        "head_top right_wrist right_elbow right_shoulder left_shoulder left_elbow left_wrist"
    ),
    "ap10k_17": (
        "L_Eye R_Eye Nose Neck Root_of_tail L_Shoulder L_Elbow L_F_Paw R_Shoulder R_Elbow R_F_Paw "
        "L_Hip L_Knee L_B_Paw R_Hip R_Knee R_B_Paw"
    ),
    "superanimal_quadruped": (
        "nose upper_jaw lower_jaw mouth_end_right mouth_end_left right_eye right_earbase "
        "right_earend right_antler_base right_antler_end left_eye left_earbase left_earend "
        "left_antler_base left_antler_end neck_base neck_end throat_base throat_end back_base "
        "back_end back_middle tail_base tail_end front_left_thai front_left_knee front_left_paw "
        "front_right_thai front_right_knee front_right_paw back_left_paw back_left_thai "
        "back_right_thai back_left_knee back_right_knee back_right_paw belly_bottom "
        "body_middle_right body_middle_left"
    ),
    "superanimal_topviewmouse": (
        "nose left_ear right_ear left_ear_tip right_ear_tip left_eye right_eye neck mid_back "
        "mouse_center mid_backend mid_backend2 mid_backend3 tail_base tail1 tail2 tail3 tail4 "
        "tail5 left_shoulder left_midside left_hip right_shoulder right_midside right_hip "
        "tail_end head_midpoint"
    ),
}
LAYOUTS = {name: tuple(text.split()) for name, text in _TEXTS.items()}


def parse_layout(text: str) -> tuple[str, ...]:
    """Return the names of a layout, or names separated by commas. Raises MismatchError."""
    if text in LAYOUTS:
        return LAYOUTS[text]
    names = tuple(name.strip() for name in text.split(","))
    if len(names) < 2 or not all(names):
        raise MismatchError(
            "",
            f"a layout ({', '.join(LAYOUTS)}) or names of keypoints separated by commas",
            one_line(text, 200),
            suggest(text, LAYOUTS),
        )
    return names


def choose_layout(
    count: int, *, given: tuple[str, ...], source: str, unambiguous: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Return the names of `count` keypoints.

    given: the names that the user or the file gives; they are taken where there are any.
    unambiguous: layouts that are the program's only ones of their length; else the one of these
        that has as many names is taken.

    Two layouts of one length differ in their order: which one it is, is never guessed.
    Raises FormatError.
    """
    if given:
        _check_count(count, given, source)
        return given
    fitting = [name for name in unambiguous if len(LAYOUTS[name]) == count]
    if len(fitting) == 1:
        return LAYOUTS[fitting[0]]
    of_this_length = [name for name, names in LAYOUTS.items() if len(names) == count]
    raise FormatError(
        source,
        f"the names of its {count} keypoints",
        "numbers alone",
        layout_remedy(of_this_length),
    )


def layout_remedy(names: list[str]) -> str:
    """Return what to do about a file that needs one of these layouts, or names of its own."""
    if names:
        return f"give {argument('layout')} ({' or '.join(names)})"
    return f"give {argument('layout')} with names separated by commas"


def _check_count(count: int, given: tuple[str, ...], source: str) -> None:
    if len(given) != count:
        raise FormatError(
            source,
            f"{len(given)} keypoints, as many as the layout has",
            count,
            f"give {argument('layout')} with as many names as the file has keypoints",
        )
