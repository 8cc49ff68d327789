"""mocap-calib triangulate: 3D poses."""

from pathlib import Path

import click

from mocap_calib_cli import options


@click.command(name="triangulate")
@options.output_file(
    "Poses: a .h5 file, or a .csv file (several individuals go to NAME_0.csv, NAME_1.csv, ...)."
)
@options.shared_options("rig", "matches", "skeleton", *options.KEYPOINTS, "quiet")
def command(shared: options.SharedOptions, output: Path) -> None:
    """Triangulate the 3D poses of all individuals in all frames.

    \b
    Example, in the folder examples/three_people:
      mocap-calib triangulate keypoints/ --rig out/cameras.yaml --matches out/matches.csv -o p.h5
    """
    from mocap_calib.errors import MismatchError
    from mocap_calib.io.provenance import provenance
    from mocap_calib.io.results.poses_csv import check_poses_csv, write_poses_csv
    from mocap_calib.io.results.poses_h5 import write_poses_h5
    from mocap_calib.multi_view.triangulation import triangulate
    from mocap_calib.recording.joints import edges_of_keypoints
    from mocap_calib.steerpose.weights import load_vocabulary
    from mocap_calib_cli import inputs, outputs
    from mocap_calib_cli.progress import Reporter

    if output.suffix not in (".h5", ".csv"):
        raise MismatchError(
            f"{output}: expected a name that ends in .h5 or .csv, "
            f"found {output.suffix or 'no ending'}; rename it"
        )
    outputs.check_file(output)
    with Reporter(quiet=shared.quiet) as reporter:
        rig, loaded = inputs.read_recording_of_rig(shared, reporter)
        matches = inputs.read_matches(shared.matches, loaded)
        if output.suffix == ".csv":
            check_poses_csv(output, matches.individuals)
        poses = triangulate(loaded.recording, rig, matches, progress=reporter)
    if output.suffix == ".h5":
        edges = edges_of_keypoints(
            load_vocabulary(loaded.recording.model), loaded.recording.vocabulary
        )
        write_poses_h5(output, poses, provenance("triangulate"), edges=edges)
    else:
        write_poses_csv(output, poses)
