"""mocap-calib kinematics: numbers that follow from 3D poses."""

from pathlib import Path

from mocap_calib_cli import names, options, values
from mocap_calib_cli.typed import Typed, as_command


@as_command(
    "kinematics",
    options.argument("poses", values.INPUT, several=True),
    options.OUTPUT_FOLDER,
    options.option("--from format", names.POSE_FORMAT),
    options.RATE_OF_POSES,
    "skeleton",
    "quiet",
)
def command(typed: Typed) -> None:
    """Measure joint angles, speeds, contacts with the floor, and bone lengths of 3D POSES.

    POSES: a file of 3D poses in any format, files of one individual each, or the folder of a run.
    kinematics.csv has a row for each frame of an individual, bones.csv one for each bone.
    docs/kinematics.md says what each number is. Speeds are per second where the number of frames
    per second is known, else per frame. Contacts need that number, and poses that say where the
    floor is.

    \b
    Example, in the folder examples/three_people:
      mocap-calib kinematics out --fps 30 -o out/kinematics
      mocap-calib kinematics anna.trc -o anna

    poses: 3D poses: the folder of `run`, or files of a 3D format of docs/formats.md.
    output: Folder to write the tables to; made when missing.
    format: Format of POSES, where their content does not show it.
    fps: Frames per second, where the file does not say.
    """
    from mocap_calib.errors import count
    from mocap_calib.io.conversion import load_pose_sources
    from mocap_calib.io.kinds import check_sources
    from mocap_calib.io.results.kinematics_csv import write_kinematics
    from mocap_calib.kinematics import define, measure
    from mocap_calib.recording.joints import fit_vocabulary
    from mocap_calib_cli.screen import Reporter

    check_sources(typed.poses)
    file = load_pose_sources([Path(each) for each in typed.poses], typed.format, typed.fps)
    names = file.poses.keypoints if typed.skeleton else file.spelt
    definitions = define(names, *fit_vocabulary(names, typed.skeleton))
    rate = file.rate if file.rate > 0 else None
    found = measure(file.poses, rate, definitions)
    write_kinematics(typed.output, found, file.individuals)
    frames, individuals = file.poses.positions.shape[:2]
    Reporter(quiet=typed.quiet).say(
        *file.notes,
        *found.notes,
        f"{count(individuals, 'individual')} in {count(frames, 'frame')}: "
        f"{count(len(found.bones), 'bone')}, {count(len(found.angles), 'angle')}, "
        f"{count(len(found.speeds), 'speed')}, {count(len(found.contacts), 'contact')}; "
        f"results in {typed.output}",
    )
