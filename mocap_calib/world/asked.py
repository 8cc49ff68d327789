"""Hold what is asked of a world to what a recording has, before it is calibrated."""

import re
from collections.abc import Iterable, Sequence

from mocap_calib.config import WORLDS, CueConfig, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.recording.epochs import own_names, views_by_camera
from mocap_calib.recording.joints import normalise_name
from mocap_calib.types import METRES, Recording
from mocap_calib.world.alignment import check_landmarks, shared_cameras
from mocap_calib.world.body import Joints, joints_of_recording
from mocap_calib.world.floor import NO_FEET, has_feet


def check_world(config: WorldConfig, recording: Recording, individuals: int | None = None) -> None:
    """Raise MismatchError for what is asked for and can be seen not to be had.

    That is unknown joints, cameras, axes and individuals, what does not go together, and a floor
    or a stature of bodies without feet.

    individuals: how many there are at most, None = nobody knows.
    """
    cameras = own_names(recording.names)
    joints = joints_of_recording(recording)
    _check_axes(config, cameras, joints)
    if config.forward:
        joint_pair(config.forward, recording.keypoints, joints, "--forward")
    known_scale = config.landmarks or (config.cameras and config.unit in METRES)
    if config.cues and known_scale:
        raise MismatchError(
            "scale: expected lengths from one source, found known lengths beside a world that has "
            "its unit; leave out --height, --length and --camera-distance"
        )
    check_cues(config.cues, recording.keypoints, joints, recording.names, config.measure)
    for cue in config.cues:
        if cue.kind == "height" and cue.of:
            _check_number(cue.of, individuals)


def _check_axes(config: WorldConfig, cameras: Sequence[str], joints: Joints) -> None:
    """Raise MismatchError for axes that are not known, and a floor under bodies without feet."""
    if config.cameras:
        shared_cameras(config.cameras, cameras)
    elif config.axes not in (*WORLDS, *cameras):
        offered = ", ".join((*WORLDS, *cameras))
        raise MismatchError(
            f"--world: expected one of {offered}, or a file, found {config.axes!r}; "
            f"{suggest(config.axes, (*WORLDS, *cameras))}"
        )
    if config.landmarks:
        check_landmarks(config.landmarks, cameras, config)
    on_floor = not config.cameras and not config.landmarks and config.axes in ("auto", "floor")
    if config.forward and not on_floor:
        raise MismatchError(
            "--forward: expected a world on the floor, whose heading it says, found another; "
            "leave it, --world or --align out"
        )
    if (config.forward or config.axes == "floor") and not has_feet(joints):
        option = "--forward" if config.forward else "--world floor"
        raise MismatchError(
            f"{option}: expected subjects that show a floor, found that {NO_FEET} (of people, or "
            "of animals on four legs); leave it out"
        )


def _check_number(text: str, individuals: int | None) -> None:
    """Raise MismatchError for what is no number that a run gives to an individual."""
    index = individual_index(text)
    if index is not None and (individuals is None or index < individuals):
        return
    known = "0, 1, ..." if individuals is None else f"0 to {individuals - 1}"
    raise MismatchError(
        f"--height {text}=...: expected the number of an individual ({known}), found {text!r}; "
        "correct it, or run without it and say `mocap-calib scale OUT --height ID=METRES` then"
    )


def individual_index(text: str, individuals: Sequence[str] = ()) -> int | None:
    """Return the index of an individual by its number or name, None for other texts.

    individuals: names, where they have others than results give them: individual_0, ...
    """
    if text in individuals:
        return individuals.index(text)
    found = re.fullmatch("(?:individual_)?(0|[1-9][0-9]{0,8})", text)
    return int(found[1]) if found else None


def check_cues(
    cues: Sequence[ScaleCue],
    keypoints: tuple[str, ...],
    joints: Joints,
    views: Sequence[str],
    config: CueConfig,
    *,
    individuals: Sequence[str] = (),
) -> None:
    """Hold lengths to what keypoints and cameras have names for.

    views: names of the cameras' views. individuals: names, as `individual_index` takes them.

    Raises MismatchError for unknown names, statures that nobody has, and where the same length is
    said twice.
    """
    seen: set[tuple[str, frozenset[object]]] = set()
    for cue in cues:
        what: frozenset[object] = frozenset([cue.of])
        if cue.kind == "height":
            head_columns(joints, config)
            _check_stature(cue.metres, config)
            index = individual_index(cue.of, individuals)
            what = frozenset([cue.of if index is None else index])
        elif cue.kind == "length":
            what = frozenset(joint_pair(cue.of, keypoints, joints, "--length"))
        else:
            what = frozenset(camera_pair(cue.of, views, "--camera-distance"))
        if (cue.kind, what) in seen:
            whose = ", or whose each is" if cue.kind == "height" else ""
            raise MismatchError(
                f"scale: expected each length once, found {describe_cue(cue)} twice; "
                f"say it once{whose}"
            )
        seen.add((cue.kind, what))


def _check_stature(metres: float, config: CueConfig) -> None:
    """Raise MismatchError for a stature that nobody has."""
    least, most = config.statures
    if least <= metres <= most:
        return
    divisor = next((each for each in (100, 1000) if least <= metres / each <= most), None)
    asks = {100: "were centimetres meant", 1000: "were millimetres meant"}
    advice = f"{asks[divisor]}? say {metres / divisor:g}" if divisor else "correct it"
    raise MismatchError(
        f"--height: expected the stature of a person in metres, {least:g} to {most:g}, "
        f"found {metres:g}; {advice}"
    )


def describe_cue(cue: ScaleCue) -> str:
    """Return what a cue is of: `height of 0`, `length left_hip-left_knee`."""
    if cue.kind == "height":
        return f"height of {cue.of}" if cue.of else "height"
    return f"{cue.kind} {cue.of}"


def head_columns(joints: Joints, config: CueConfig) -> list[tuple[int, float]]:
    """Return the points of the head, and how high each is in statures.

    Raises MismatchError where there are none, and where feet are missing to measure from.
    """
    heads = [(joints.columns[name], share) for name, share in config.head_height
             if name in joints.columns]  # fmt: skip
    if joints.kind != "people" or not heads or not has_feet(joints):
        raise MismatchError(
            "--height: expected people with ankles and points of the head (head_top, eyes, ears "
            "or nose), found none; say a --length or --camera-distance"
        )
    return heads


# --- pairs of joints, pairs of cameras


def joint_pair(
    text: str, keypoints: tuple[str, ...], joints: Joints, option: str
) -> tuple[int, int]:
    """Return the indices of two keypoints of `A-B`, by their own names or those of joints.

    Raises MismatchError.
    """
    known = {normalise_name(name): k for name, k in joints.columns.items()}
    known |= {normalise_name(name): k for k, name in enumerate(keypoints)}
    known |= {name: k for k, name in enumerate(keypoints)}
    first, second = split_pair(text, known, "joints", keypoints, option)
    a, b = _lookup(known, first), _lookup(known, second)
    if a == b:
        raise MismatchError(
            f"{option} {text}: expected two joints, found one, {keypoints[a]}, under two names; "
            "say another pair"
        )
    return a, b


def camera_pair(text: str, views: Sequence[str], option: str) -> tuple[int, int]:
    """Return the indices of the views of two cameras of `A-B`. Raises MismatchError."""
    known = {name: own[0] for name, own in views_by_camera(views).items()}
    first, second = split_pair(text, known, "cameras", tuple(known), option)
    return known[first], known[second]


def split_pair(
    text: str, known: Iterable[str], what: str, offered: Sequence[str], option: str
) -> tuple[str, str]:
    """Return the two names of `A-B`, either of which may have a `-`. Raises MismatchError."""
    names = set(known)
    parts = text.split("-")
    halves = [("-".join(parts[:k]), "-".join(parts[k:])) for k in range(1, len(parts))]
    for first, second in halves:
        if _is_known(first, names) and _is_known(second, names) and first != second:
            return first, second
    if _is_known(text, names):
        raise MismatchError(
            f"{option} {text}: expected two {what}, as A-B, found one; add the second"
        )
    same = next((a for a, b in halves if a == b and _is_known(a, names)), "")
    if same:
        raise MismatchError(
            f"{option} {text}: expected two {what}, found {same!r} twice; correct it"
        )
    stranger = next((half for pair in halves for half in pair if not _is_known(half, names)), text)
    raise MismatchError(
        f"{option} {text}: expected two {what}, as A-B, of {', '.join(offered)}, "
        f"found {stranger!r}; {suggest(stranger, offered)}"
    )


def _is_known(name: str, names: set[str]) -> bool:
    return name in names or normalise_name(name) in names


def _lookup(known: dict[str, int], name: str) -> int:
    return known[name] if name in known else known[normalise_name(name)]
