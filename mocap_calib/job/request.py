"""What is asked for: which recording to calibrate, how, and where the results go."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mocap_calib.compute.program import identify_program
from mocap_calib.config import PAIR_SOLVERS, Config
from mocap_calib.io.file import plain_path
from mocap_calib.io.hashing import hash_inputs
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.lift.weights import identify_model
from mocap_calib.results import Mend


@dataclass(frozen=True)
class KeypointSource:
    """Which keypoints are read, and how.

    paths: files, folders and name=path pairs, as `read_keypoints` takes them.
    format: name of their format; None: their content shows it.
    options: what the files do not say themselves.
    aliases: a YAML file with other names of joints, see `load_aliases`.
    model: name of a shipped model, a weights file, or "none" for geometry alone; None: the
        shipped model that knows most of the joints.
    mends: what is known to be wrong with the files, put right in this order.
    """

    paths: tuple[str, ...]
    format: str | None = None
    options: ReadOptions = field(default_factory=ReadOptions)
    aliases: Path | None = None
    model: str | None = None
    mends: tuple[Mend, ...] = ()


@dataclass(frozen=True)
class CalibrationRequest:
    """Which recording to calibrate, how, and where the results go.

    cameras: a file or folder with the intrinsics, or the content of such a file; None: nothing is
        known of them but the sizes of the images.
    output: the folder of the results.
    pair_solver: how a pair of views is calibrated, one of `config.PAIR_SOLVERS`.
    device: where the network computes, "cpu" or "cuda".
    formats: names of further formats of cameras and 3D poses in which the results are written.
    fps: frames per second, for the formats that need it.
    report: whether report.html is written. reading: the options that say how the keypoints are
        read, as a user typed them, for run.json.
    """

    keypoints: KeypointSource
    cameras: Path | bytes | None
    output: Path
    pair_solver: str = PAIR_SOLVERS[0]
    seed: int = 0
    device: str = "cpu"
    config: Config = field(default_factory=Config)
    formats: tuple[str, ...] = ()
    fps: float | None = None
    report: bool = True
    reading: Mapping[str, Any] = field(default_factory=dict)

    def hash_inputs(self) -> dict[str, str]:
        """Return the SHA-256 of all files that the results follow from, by path."""
        paths = [plain_path(argument) for argument in self.keypoints.paths]
        if isinstance(self.cameras, Path):
            paths.append(self.cameras)
        if self.keypoints.aliases is not None:
            paths.append(self.keypoints.aliases)
        return hash_inputs(paths)

    def fingerprint(self, hashes: Mapping[str, str], model: str) -> str:
        """Return the SHA-256 of all that the results follow from.

        That is what was asked for, the files, the configuration, the weights and the code.

        hashes: of the inputs, by path. model: the one that was chosen.
        """
        files = [self.formats, self.fps]
        asked = [asdict(self.keypoints), self.cameras, self.seed, self.device, *files]
        content = json.dumps([asked, hashes, self.describe_method(model)], default=str)
        return hashlib.sha256(content.encode()).hexdigest()

    def describe_method(self, model: str) -> str:
        """Return how any recording is calibrated: solver, configuration, weights and code."""
        method = [self.pair_solver, asdict(self.config)]
        return json.dumps([*method, model, identify_model(model), identify_program()])
