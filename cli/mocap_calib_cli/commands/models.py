"""mocap-calib models: the weights that are shipped."""

import json

import click

from mocap_calib_cli import options


@click.command(name="models")
@options.as_json("Write the whole model cards.")
def command(as_json: bool) -> None:
    """Lists the shipped models: what they know, what they were trained on, on which terms, and how large their error is.

    `run` takes the one that knows most of the recording's joint names.

    \b
    Example:
      mocap-calib models
    """
    from mocap_calib.recording.joints import load_skeleton
    from mocap_calib.steerpose.checkpoint import models
    from mocap_calib_cli.progress import figure, table

    cards = models()
    if as_json:
        click.echo(json.dumps(cards, indent=1))
        return
    rows = [
        [
            name,
            str(len(load_skeleton(name).keypoints)),
            *(figure(card["held_out_error"][key], 3) for key in _ERRORS),
        ]
        for name, card in cards.items()
    ]
    click.echo("\n".join(table(["model", "joints", *_ERRORS.values()], rows)))
    for name, card in cards.items():
        click.echo(
            f"\n{name}\n  data: {card['data']}\n  terms: {card['terms']}\n  command: {card['command']}"
        )


_ERRORS = {
    "joint_3d": "3D error",
    "steered_2d": "steered",
    "completed_2d": "completed",
}  # of the RMS radius of the visible pose
