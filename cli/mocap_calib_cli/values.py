"""What options and arguments take: words where a value is missing, and what the shell offers.

The functions `offer_...` are click's `shell_complete`: they get what has been typed of a value, and
return what it may become, with a word on each that zsh and fish show. The tables of formats are
imported when they are asked for, so that --help is quick; torch never is.
"""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem


class PathOf(click.Path):
    """A file or folder; `missing` says what it is, and where to get it, when it was left out."""

    def __init__(self, missing: str = "", **settings: Any) -> None:
        super().__init__(**settings)
        self.missing = missing

    def get_missing_message(
        self, param: click.Parameter, ctx: click.Context | None = None
    ) -> str | None:
        """Return the words that follow "Missing option"."""
        return self.missing or None


class IntrinsicsPath(PathOf):
    """The file of the cameras' intrinsics; its message lists the formats that are read."""

    def get_missing_message(
        self, param: click.Parameter, ctx: click.Context | None = None
    ) -> str | None:
        """Return what intrinsics are, where to get them, and the formats that are read."""
        from mocap_calib.io.cameras.formats import CAMERA_FORMATS

        return (
            "Expected a file with the intrinsics of each camera (focal length, principal point, "
            "lens distortion), found none; film a checkerboard or ChArUco board with each camera, "
            "calibrate with anipose, caliscope, OpenCV, Kalibr or the like, and give the file that "
            f"it writes. Formats: {', '.join(each.name for each in CAMERA_FORMATS)} "
            "(docs/formats.md)."
        )


class NameOrFile(click.types.StringParamType):
    """A word that the command knows, or a file, which its ending or its being there tells."""

    endings = (".toml", ".yaml", ".yml", ".json", ".xml", ".csv", ".txt", ".safetensors")

    def is_file(self, path: Path) -> bool:
        """Return whether it is a file rather than a word or the name of a camera."""
        # pathlib complains of names that are too long for a file
        return path.suffix.lower() in self.endings or os.path.isfile(path)


def wrong_form(form: str, text: str, option: str) -> click.BadParameter:
    """Return the complaint about a value that is not written as the option wants it."""
    from mocap_calib.errors import one_line

    found = one_line(text, width=200)
    return click.BadParameter(f"expected {form}, found {found}", param_hint=option)


KEYPOINTS = PathOf(
    "Expected the folder with the 2D keypoints, or a file for each camera; "
    "docs/formats.md lists the formats."
)
RECORDINGS = PathOf("Expected a folder for each recording, with its keypoint files.")
INTRINSICS = IntrinsicsPath()
RIG = PathOf(
    "Expected a file that says where the cameras stand; give the cameras.yaml of `run`, or what "
    "`average` or `adjust` wrote."
)
MATCHES = PathOf("Expected a file that says who is who; give what `match` wrote.")
REFERENCE = PathOf(
    "Expected a calibration to compare with, in any camera format of docs/formats.md, with the "
    "same names of cameras."
)
PAIRS = PathOf("Expected the file that `pairwise` wrote; - reads stdin.")
POSES = PathOf(
    "Expected 3D poses; give the folder of `run`, or files of a 3D format of docs/formats.md."
)
ANY_PATH = PathOf()
NAME_OR_FILE = NameOrFile()


# --- what the shell offers


def _offer(
    list_values: Callable[[], Mapping[str, str]], *, files: bool = False
) -> Callable[[click.Context, click.Parameter, str], "list[CompletionItem]"]:
    """Return click's `shell_complete` for an option that takes one of these values.

    list_values: returns value -> what it is. files: the option takes files as well.
    """

    def complete(
        _context: click.Context, _param: click.Parameter, incomplete: str
    ) -> "list[CompletionItem]":
        """Return the values that begin as what was typed."""
        from click.shell_completion import CompletionItem

        items = [
            CompletionItem(value, help=text)
            for value, text in list_values().items()
            if value.startswith(incomplete)
        ]
        return [*items, CompletionItem(incomplete, type="file")] if files else items

    return complete


def _list_formats(
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


def _list_layouts() -> dict[str, str]:
    """Return name -> number of points of the layouts of keypoints."""
    from mocap_calib.io.keypoints.layouts import LAYOUTS

    return {name: f"{len(names)} keypoints" for name, names in LAYOUTS.items()}


def _list_models() -> dict[str, str]:
    """Return the shipped models, and how to do without one."""
    from mocap_calib.lift.lifter import shipped_tokens
    from mocap_calib.recording.joints import SHIPPED

    models = dict.fromkeys(SHIPPED, "shipped weights") | {"none": "geometry alone"}
    return models | dict.fromkeys(shipped_tokens(), "the paper's, for --solver paper")


def _list_skeletons() -> dict[str, str]:
    """Return the shipped skeletons."""
    from mocap_calib.recording.joints import SHIPPED

    return dict.fromkeys(SHIPPED, "shipped skeleton")


_KINDS = ("poses", "keypoints", "cameras")

offer_keypoint_formats = _offer(partial(_list_formats, "keypoints"))
offer_written_keypoint_formats = _offer(partial(_list_formats, "keypoints", written=True))
offer_written_camera_formats = _offer(partial(_list_formats, "cameras", written=True))
offer_formats = _offer(partial(_list_formats, *_KINDS, read=True))
offer_pose_formats = _offer(partial(_list_formats, "poses", read=True))
offer_written_formats = _offer(partial(_list_formats, *_KINDS, written=True))
# the lengths of a run are arbitrary
offer_result_formats = _offer(
    partial(_list_formats, "poses", "cameras", written=True, unitless=True)
)
offer_layouts = _offer(_list_layouts)
offer_models = _offer(_list_models, files=True)
offer_skeletons = _offer(_list_skeletons, files=True)
