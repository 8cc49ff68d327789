"""mocap-calib models: the networks that are shipped."""

import json

from mocap_calib_cli.options import AS_JSON
from mocap_calib_cli.screen import echo
from mocap_calib_cli.typed import Typed, as_command

# of the RMS radius of the visible pose
_ERRORS = {"joint_3d": "3D error", "steered_2d": "steered", "completed_2d": "completed"}


@as_command("models", AS_JSON)
def command(typed: Typed) -> None:
    """List the shipped models: their joints, training data, terms, and errors.

    `run` takes the one that knows most of the recording's joint names. Errors are measured on poses
    that were not trained on, as shares of the size of the body in the image (1 is the RMS distance
    of its joints from their middle): of the 3D pose, of the pose seen from another camera
    (steered), and of joints that were hidden (completed).

    \b
    Example:
      mocap-calib models

    as_json: Write the whole model cards.
    """
    from mocap_calib.lift.lifter import models
    from mocap_calib.recording.joints import load_skeleton
    from mocap_calib_cli.screen import format_number, format_table

    cards = models()
    if typed.as_json:
        echo(json.dumps(cards, indent=1))
        return
    rows = []
    for name, card in cards.items():
        errors = [format_number(card["held_out_error"][key], 3) for key in _ERRORS]
        rows.append([name, str(len(load_skeleton(name).keypoints)), *errors])
    echo("\n".join(format_table(["model", "joints", *_ERRORS.values()], rows)))
    for name, card in cards.items():
        echo(f"\n{name}")
        for key in ("data", "terms", "command"):
            echo(f"  {key}: {card[key]}")
