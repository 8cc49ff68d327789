"""The command on each model card is one: it runs, for a few steps, on files of the card's names."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import mocap_calib
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.training import poses, train
from mocap_calib_cli.commands.train import command

CARDS = sorted((Path(mocap_calib.__file__).parent / "weights").glob("*.md"))


@pytest.mark.slow
@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.stem)
def test_the_command_of_a_card_trains(card, tmp_path, monkeypatch):
    """Poses are made here: those of the card are its publisher's."""
    monkeypatch.chdir(tmp_path)
    for measure in (train.held_out_error, train.measure_steering_error):  # on few views: quick
        monkeypatch.setitem(measure.__wrapped__.__kwdefaults__, "examples", 64)
    make = poses.procedural_poses
    few = lambda names, body, _, seed: make(names, body, 500, seed=seed)  # noqa: E731
    monkeypatch.setattr(poses, "procedural_poses", few)
    (typed,) = re.findall(r"`mocap-calib train ([^`]+)`", card.read_text("utf-8"))
    words = shlex.split(typed)
    for name, value in (("--steps", "2"), ("--batch", "8")):
        if name in words:
            words[words.index(name) + 1] = value
    skeleton = load_skeleton(words[words.index("--skeleton") + 1])
    options = {k + 1 for k, word in enumerate(words) if word.startswith("-")}
    for k, word in enumerate(words):
        if k not in options and not word.startswith("-"):
            write_poses(Path(word), skeleton.keypoints)
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0, done.output
    assert Path(words[words.index("-o") + 1]).stat().st_size > 10_000


def write_poses(path: Path, joints: tuple[str, ...]) -> None:
    """A file, or a folder, of poses that are all alike but for noise."""
    if not path.suffix:
        path.mkdir()
        path = path / "poses3d.npz"
    rng = np.random.default_rng(0)
    body = rng.normal(size=(len(joints), 3))
    np.savez(path, poses=body + 0.05 * rng.normal(size=(60, len(joints), 3)), joints=joints)
