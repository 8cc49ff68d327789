"""Sizes of a report.html."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportConfig:
    """How much a report.html shows. Bytes are those of the page.

    limit: bytes of the page. spare: bytes that are kept free. share_of_run: of the bytes for data,
        that run.json may take. share_of_bodies: of what is left after all else, the rest is for
        detections.
    stretch: frames that follow each other, where not all are shown, and least_stretches of them.
    full: share of the room for bodies or detections that is enough, and fillings: how often it is
        tried to fill it.
    step: that positions are rounded to, in sizes of a body (distance of a joint from its middle).
    pixel_step: that detections are rounded to. residual_step: the same of mean errors, in pixels.
    mantissa_bits: of numbers in single precision.
    cells: columns and rows of an image, few_cells in rigs of more than many_views cameras.
    most_bins, least_bins: of errors over time, view_bins in all. series_bins: of lengths of bones
        and the like, series_numbers in all. most_keypoints: that are looked at for either.
    most_individuals, most_runs, most_swaps: that are listed.
    """

    limit: int = 2_990_000
    spare: int = 4000
    share_of_run: float = 0.5
    share_of_bodies: float = 0.6
    stretch: int = 60
    least_stretches: int = 8
    full: float = 0.7
    fillings: int = 5
    step: float = 0.002
    pixel_step: float = 0.25
    residual_step: float = 0.01
    mantissa_bits: int = 12
    cells: tuple[int, int] = (24, 14)
    few_cells: tuple[int, int] = (12, 7)
    many_views: int = 64
    most_bins: int = 100
    least_bins: int = 10
    view_bins: int = 1500
    series_bins: int = 300
    series_numbers: int = 60_000
    most_keypoints: int = 1_000_000
    most_individuals: int = 100
    most_runs: int = 20_000
    most_swaps: int = 1000
