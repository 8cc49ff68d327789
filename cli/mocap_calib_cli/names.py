"""The types of arguments that are names: of formats, layouts, models and skeletons.

The shell offers them. What lists them is imported when it is asked for, so that --help is quick.
"""

from functools import partial

from mocap_calib_cli.values import NameOrFile, Written


def _formats(
    *kinds: str, read: bool = False, written: bool = False, unitless: bool = False
) -> dict[str, str]:
    """Return name -> titles of the formats of these kinds of files.

    read, written: those alone that are read, or written. unitless: those alone that do without a
        unit of length.
    """
    from mocap_calib.io.kinds import FORMATS

    titles: dict[str, str] = {}
    for kind, formats in FORMATS.items():
        for each in formats if kind in kinds else ():
            left_out = (not each.read and read) or (not each.write and written)
            if not left_out and not (each.unit and unitless):
                known = titles.get(each.name)
                titles[each.name] = f"{known}; {each.title}" if known else each.title
    return titles


def _layouts() -> dict[str, str]:
    """Return name -> number of points of the layouts of keypoints."""
    from mocap_calib.io.read_options import layouts

    return {name: f"{len(names)} keypoints" for name, names in layouts().items()}


def _layout(text: str) -> tuple[str, ...]:
    """Return the names of a layout, or those typed. Raises MismatchError."""
    from mocap_calib.io.read_options import parse_layout

    return parse_layout(text)


def _models() -> dict[str, str]:
    """Return the shipped models, and how to do without one."""
    from mocap_calib.lift.lifter import shipped_tokens
    from mocap_calib.recording.joints import SHIPPED

    models = dict.fromkeys(SHIPPED, "shipped weights") | {"none": "geometry alone"}
    return models | dict.fromkeys(shipped_tokens(), "the paper's, for --solver paper")


def _skeletons() -> dict[str, str]:
    """Return the shipped skeletons."""
    from mocap_calib.recording.joints import SHIPPED

    return dict.fromkeys(SHIPPED, "shipped skeleton")


_KINDS = ("poses", "keypoints", "cameras")

LAYOUT = Written("NAME", read=_layout, offers=_layouts)
MODEL = NameOrFile("NAME|FILE|none", offers=_models, files=True)
WORLD = NameOrFile("WORLD")
SKELETON = Written("NAME|FILE.yaml", offers=_skeletons, files=True)
KEYPOINT_FORMAT = Written("NAME", offers=partial(_formats, "keypoints"))
WRITTEN_KEYPOINT_FORMAT = Written("FORMAT", offers=partial(_formats, "keypoints", written=True))
WRITTEN_CAMERA_FORMAT = Written("FORMAT", offers=partial(_formats, "cameras", written=True))
POSE_FORMAT = Written("FORMAT", offers=partial(_formats, "poses", read=True))
FORMAT = Written("FORMAT", offers=partial(_formats, *_KINDS, read=True))
WRITTEN_FORMAT = Written("FORMAT", offers=partial(_formats, *_KINDS, written=True))
# a run does not know the unit of its lengths
RESULT_FORMAT = Written(
    "FORMAT", offers=partial(_formats, "poses", "cameras", written=True, unitless=True)
)
