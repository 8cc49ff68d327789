"""All recordings of a folder, one after the other, and a table of the verdicts.

python many_recordings.py SESSIONS OUT

SESSIONS/NAME/keypoints and SESSIONS/NAME/intrinsics.toml for each recording. `mocap-calib batch`
does this too, in several processes, and goes on where it was interrupted.
"""

import csv
import sys
from pathlib import Path

import mocap_calib as mc


def calibrate(session: Path, out: Path) -> tuple[str, str]:
    """Calibrate a recording; return the verdict, and why it is no better."""
    try:
        recording = mc.read_recording(session / "keypoints", session / "intrinsics.toml")
        result = mc.calibrate(recording)
    except mc.MocapCalibError as error:  # what is wrong with files or data, in one line
        return "refused", str(error)
    mc.write(result, out / session.name)
    return result.groups[0].verdict, " ".join(map(str, result.groups[0].reasons))


def main(sessions: Path, out: Path) -> None:
    """Calibrate all recordings, and write OUT/verdicts.csv."""
    folders = sorted(folder for folder in sessions.iterdir() if folder.is_dir())
    rows = [(folder.name, *calibrate(folder, out)) for folder in folders]
    out.mkdir(parents=True, exist_ok=True)
    with (out / "verdicts.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("recording", "verdict", "why"), *rows])
    for row in rows:
        print(*row, sep="  ")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
