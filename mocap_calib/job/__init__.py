"""One recording from its files to its results."""

from mocap_calib.job.load import LoadedRecording, find_ignored_files, load_recording
from mocap_calib.job.request import CalibrationRequest, KeypointSource
from mocap_calib.job.steps import (
    Job,
    WrittenGroup,
    calibrate_job,
    calibrate_job_resumably,
    find_finished,
    read_job,
    write_result,
    write_results,
)

__all__ = [
    "CalibrationRequest",
    "Job",
    "KeypointSource",
    "LoadedRecording",
    "WrittenGroup",
    "calibrate_job",
    "calibrate_job_resumably",
    "find_finished",
    "find_ignored_files",
    "load_recording",
    "read_job",
    "write_result",
    "write_results",
]
