"""Find two cameras of which each has the intrinsics of the other.

Each looks odd by itself, and spoils the rig that it would be held against: both are tried at once.
Only focal lengths that differ give them away.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mocap_calib.adjust.refine import adjust_once, measure_distances
from mocap_calib.config import Config, ExchangedConfig
from mocap_calib.errors import DegenerateError
from mocap_calib.recording.corrections import Exchanged
from mocap_calib.recording.sampling import with_cameras
from mocap_calib.results import Fault, GroupResult, Matches
from mocap_calib.rig.observed import Observed
from mocap_calib.rig.tracks import view_residual
from mocap_calib.types import CameraRig, Floats, Sample

_LEAST_CAMERAS = 3  # of two nobody can say


@dataclass(frozen=True)
class _Finding:
    """What an exchange of the intrinsics of two views lowers the robust cost of a keypoint by.

    significance: in standard errors, over stretches of time.
    """

    views: tuple[int, int]
    gain: float
    significance: float


def find_exchanged_cameras(
    observed: Observed, group: GroupResult, config: Config
) -> tuple[Fault, ...]:
    """Return the faults of the two cameras whose files are exchanged; nothing where none are."""
    rig, matches = group.adjusted.rig, group.adjusted.matches
    likely = likely_pairs(group, config.exchanged)
    if not likely:
        return ()
    names = observed.recording.names
    sample = observed.sample.select(views=np.array([names.index(name) for name in rig.names]))
    rough = replace(config, adjust=replace(config.adjust, points=config.exchanged.points))
    tried = [_try_exchange(sample, rig, matches, views, rough) for views in likely]
    found = max((each for each in tried if each), key=lambda each: each.gain, default=None)
    if found is None or not _is_decisive(found, config.exchanged):
        return ()
    a, b = (rig.names[view] for view in found.views)
    evidence: dict[str, float | int | str] = {
        "gain": found.gain,
        "significance": found.significance,
    }
    return tuple(
        Fault(one, "exchanged", f"has the intrinsics of {other}", evidence, Exchanged(a, b))
        for one, other in ((a, b), (b, a))
    )


def _is_decisive(found: _Finding, config: ExchangedConfig) -> bool:
    """Return whether an exchange explains certainly more."""
    return found.gain > config.least_gain and found.significance > config.least_significance


def likely_pairs(group: GroupResult, config: ExchangedConfig) -> list[tuple[int, int]]:
    """Return the pairs of views whose focal lengths would change to those of each other.

    The likeliest first.
    """
    change, sigma = group.uncertainty.focal_change, group.uncertainty.focal_sigma
    focal = np.log([camera.focal for camera in group.rig.cameras])
    if len(focal) < _LEAST_CAMERAS or not np.isfinite(change).all():
        return []
    variance = sigma**2 + config.focal_systematic**2
    found = []
    for a, b in combinations(range(len(focal)), 2):
        ends, other = np.array([a, b]), focal[[b, a]] - focal[[a, b]]
        squares = change[ends] ** 2 - (change[ends] - other) ** 2
        nats = squares / (2 * variance[ends])
        likelier = nats.sum() > config.least_nats and (nats > 0).all()
        if likelier and abs(focal[a] - focal[b]) > config.least_difference:
            found.append((float(nats.sum()), (a, b)))
    return [views for _, views in sorted(found, reverse=True)[: config.candidates]]


def _try_exchange(
    sample: Sample, rig: CameraRig, matches: Matches, views: tuple[int, int], config: Config
) -> _Finding | None:
    """Return what it helps to exchange the intrinsics of two views, None where nothing fits.

    Against the files as they are, and against one of the two having intrinsics as the other: a
    single wrong focal length is no exchange.
    """
    a, b = views
    try:
        exchanged = _errors_with(sample, rig, matches, {a: b, b: a}, config)
        others = [
            _errors_with(sample, rig, matches, source, config) for source in ({}, {a: b}, {b: a})
        ]
    except DegenerateError:
        return None
    usual = float(np.nanmedian(others[0]))
    gains = [_compare(given / usual, exchanged / usual, config.exchanged) for given in others]
    gain, significance = (float(min(values)) for values in zip(*gains, strict=True))
    return _Finding(views, gain, significance)


def _compare(given: Floats, other: Floats, config: ExchangedConfig) -> tuple[float, float]:
    """Return the gain of a keypoint and its significance; errors `[view, N]` in usual ones."""
    lower = np.log1p(given**2) - np.log1p(other**2)
    count = max(int(np.isfinite(lower).sum()), 1)
    blocks = np.array_split(np.nansum(lower, axis=0), config.time_blocks)
    parts = np.array([block.sum() for block in blocks])
    scatter = float(np.std(parts)) * np.sqrt(len(parts))
    return float(parts.sum()) / count, float(parts.sum()) / max(scatter, 1e-12)


def _errors_with(
    sample: Sample, rig: CameraRig, matches: Matches, source: dict[int, int], config: Config
) -> Floats:
    """Return the errors in a rig adjusted with the intrinsics of other views.

    source: the view whose intrinsics a view has, where they are not its own.
    """
    cameras = tuple(
        replace(rig.cameras[source.get(view, view)], name=camera.name)
        for view, camera in enumerate(rig.cameras)
    )
    changed = with_cameras(sample, cameras)
    start = replace(rig, cameras=cameras)
    adjusted = adjust_once(changed, start, matches, config, already_close=True)
    return _errors(changed, adjusted, matches, config)


def _errors(sample: Sample, rig: CameraRig, matches: Matches, config: Config) -> Floats:
    """Return the distances `[view, N]` in pixels of keypoints from the points; NaN = missing."""
    noise = view_residual(sample, rig, matches, config.triangulate)
    seen, _, error = measure_distances(sample, rig, matches, noise, config)
    return np.where(seen.weight > 0, error, np.nan)
