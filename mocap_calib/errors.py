"""What can go wrong through no fault of the program.

MocapCalibError
├── FormatError       a file is not what its format says
├── MismatchError     two inputs do not belong together
├── DegenerateError   the observations do not determine the answer
│   └── UnderconstrainedCameraError   not of this camera, but perhaps of the others
└── ClusterError      the machines that work was sent to cannot do it

Every message is one line: what was expected, what came, what to do. Anything else that is raised
is a mistake of the program and keeps its traceback.
"""


class MocapCalibError(Exception):
    """Base of all errors that a user can cause and mend."""


class FormatError(MocapCalibError):
    """A file is not what its format says."""


class MismatchError(MocapCalibError):
    """Two inputs do not belong together."""


class DegenerateError(MocapCalibError):
    """The observations do not determine the answer."""


class UnderconstrainedCameraError(DegenerateError):
    """A camera sees too little that agrees with others; without it they may be calibrated.

    camera: its name.
    """

    def __init__(self, message: str, camera: str) -> None:
        super().__init__(message)
        self.camera = camera


class ClusterError(MocapCalibError):
    """The machines that work was sent to cannot do it."""
