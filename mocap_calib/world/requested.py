"""Check requested axes and known lengths against the names of a recording, before a run."""

from collections.abc import Mapping, Sequence

from mocap_calib.config import WORLDS, CueConfig, ScaleCue, WorldConfig
from mocap_calib.errors import MismatchError, suggest
from mocap_calib.recording.joints import normalise_name
from mocap_calib.recording.timeline import own_names, views_by_camera
from mocap_calib.types import METRES, Recording
from mocap_calib.world.align import check_landmarks, stated_rig
from mocap_calib.world.floor import NO_FEET, Joints, joints_of_recording

OTHER_CUES = "use --length or --camera-distance"
_METRES = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}


def check_world(config: WorldConfig, recording: Recording, individuals: int | None = None) -> None:
    """Check the requested coordinates and lengths against a recording.

    individuals: how many there are at most, None = not known.

    Raises MismatchError for unknown joints, cameras, axes and individuals, requests that exclude
    each other, and a floor or a stature of bodies without feet.
    """
    cameras = own_names(recording.names)
    joints = joints_of_recording(recording)
    _check_axes(config, cameras, joints)
    if config.forward:
        joint_pair(config.forward, recording.keypoints, joints, "--forward")
    known_scale = config.landmarks or (config.cameras and config.unit in METRES)
    if config.cues and known_scale:
        raise MismatchError(
            "scale: expected lengths from one source, found known lengths and a world in a known "
            "unit; leave out --height, --length and --camera-distance"
        )
    names = (recording.keypoints, joints, recording.names)
    check_cues(config.cues, *names, config.measure, count=individuals)


def _check_axes(config: WorldConfig, cameras: Sequence[str], joints: Joints) -> None:
    """Raise MismatchError for unknown axes, and a floor below bodies without feet."""
    if config.cameras:
        stated_rig(config.cameras, cameras)
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
            "--forward: expected a world on the floor, found another; "
            "leave out --forward, --world or --align"
        )
    if (config.forward or config.axes == "floor") and not joints.have_feet:
        option = "--forward" if config.forward else "--world floor"
        raise MismatchError(
            f"{option}: expected subjects that show a floor, found that {NO_FEET} (of people, or "
            "of animals on four legs); leave it out"
        )


def check_cues(
    cues: Sequence[ScaleCue],
    keypoints: tuple[str, ...],
    joints: Joints,
    views: Sequence[str],
    config: CueConfig,
    *,
    count: int | None = None,
    individuals: Sequence[str] = (),
) -> None:
    """Compare known lengths with the names of keypoints, cameras and individuals.

    views: names of the cameras' views. count: of individuals, None = not known, and individuals:
    names that they have besides numbers.

    Raises MismatchError for unknown names, impossible statures, and lengths that are given twice.
    """
    seen: set[tuple[str, frozenset[int]]] = set()
    for cue in cues:
        if cue.kind == "height":
            head_columns(joints, config)
            _check_stature(cue.metres, config)
            own = [find_individual(cue.of, count, individuals)] if cue.of else []
            what = frozenset(own)
        elif cue.kind == "length":
            what = frozenset(joint_pair(cue.of, keypoints, joints, "--length"))
        else:
            what = frozenset(camera_pair(cue.of, views, "--camera-distance"))
        if (cue.kind, what) in seen:
            raise MismatchError(
                f"scale: expected each length once, found {describe_cue(cue)} twice; "
                "leave one of them out"
            )
        seen.add((cue.kind, what))


def describe_cue(cue: ScaleCue) -> str:
    """Return the name of a known length: `height of 0`, `length left_hip-left_knee`."""
    if cue.kind == "height":
        return f"height of {cue.of}" if cue.of else "height"
    return f"{cue.kind} {cue.of}"


def head_columns(joints: Joints, config: CueConfig) -> list[tuple[int, float]]:
    """Return the points of the head, and the height of each in statures.

    Raises MismatchError without such points, and without feet.
    """
    heads = [(joints.columns[name], share) for name, share in config.head_height
             if name in joints.columns]  # fmt: skip
    if joints.kind != "people" or not heads or not joints.have_feet:
        raise MismatchError(
            "--height: expected people with ankles and points of the head (head_top, eyes, ears "
            f"or nose), found none; {OTHER_CUES}"
        )
    return heads


def find_individual(text: str, count: int | None, individuals: Sequence[str] = ()) -> int:
    """Return the index of an individual, by its number, `individual_0` or its name.

    count: of individuals, None = not known. individuals: their names besides numbers.

    Raises MismatchError.
    """
    number = text.removeprefix("individual_")
    index = int(number) if number.isdecimal() else -1
    index = individuals.index(text) if text in individuals else index
    if index >= 0 and (count is None or index < count):
        return index
    known = ["0", "1", "..."] if count is None else [*map(str, range(count)), *individuals]
    raise MismatchError(
        f"--height {text}=...: expected an individual, one of {', '.join(known)}, "
        f"found {text!r}; {suggest(text, known)}"
    )


def joint_pair(
    text: str, keypoints: tuple[str, ...], joints: Joints, option: str
) -> tuple[int, int]:
    """Return the indices of two keypoints of `A-B`, by their own names or those of joints.

    Raises MismatchError.
    """
    known = {normalise_name(name): k for name, k in joints.columns.items()}
    known |= {normalise_name(name): k for k, name in enumerate(keypoints)}
    known |= {name: k for k, name in enumerate(keypoints)}
    return _split_pair(text, known, "joints", keypoints, option)


def camera_pair(text: str, views: Sequence[str], option: str) -> tuple[int, int]:
    """Return the indices of the views of two cameras of `A-B`. Raises MismatchError."""
    known = {name: own[0] for name, own in views_by_camera(views).items()}
    return _split_pair(text, known, "cameras", tuple(known), option)


def _split_pair(
    text: str, known: Mapping[str, int], what: str, offered: Sequence[str], option: str
) -> tuple[int, int]:
    """Return the indices of the two names of `A-B`, either of which may have a `-`.

    Raises MismatchError.
    """

    def index_of(name: str) -> int | None:
        """Return the index of a name, None if it is not known."""
        return known.get(name, known.get(normalise_name(name)))

    parts = text.split("-")
    halves = [("-".join(parts[:k]), "-".join(parts[k:])) for k in range(1, len(parts))]
    for a, b in ((index_of(first), index_of(second)) for first, second in halves):
        if a is not None and b is not None and a != b:
            return a, b
    if index_of(text) is not None:
        raise MismatchError(
            f"{option} {text}: expected two {what}, as A-B, found one; add the second"
        )
    strangers = [half for pair in halves for half in pair if index_of(half) is None]
    if halves and not strangers:
        raise MismatchError(
            f"{option} {text}: expected two {what}, found one of them twice; use another pair"
        )
    stranger = strangers[0] if strangers else text
    raise MismatchError(
        f"{option} {text}: expected two {what}, as A-B, of {', '.join(offered)}, "
        f"found {stranger!r}; {suggest(stranger, offered)}"
    )


def _check_stature(metres: float, config: CueConfig) -> None:
    """Raise MismatchError for an impossible stature."""
    least, most = config.statures
    if not least <= metres <= most:
        raise MismatchError(
            f"--height: expected the stature of a person in metres, {least:g} to {most:g}, "
            f"found {metres:g}; {likely_unit(metres, config)}"
        )


def likely_unit(stature: float, config: CueConfig) -> str:
    """Return what to do about a stature that is impossible in metres."""
    least, most = config.statures
    fits = {name: stature * unit for name, unit in _METRES.items()}
    fits = {name: metres for name, metres in fits.items() if least <= metres <= most}
    if not fits:
        return "correct it"
    name = max(fits, key=lambda each: fits[each])
    return f"were {name} meant? multiply by {_METRES[name]:g}: {fits[name]:g} m"
