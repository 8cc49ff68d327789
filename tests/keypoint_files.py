"""Write the keypoint files of other programs: COCO, and DeepLabCut in its three layouts."""

import json
import pickle

import h5py
import numpy as np


def coco(frames, names, positions, confidence, size=(640, 480), **changes):
    """Return COCO annotations of `[frame, instance, keypoint, 2]` positions.

    An instance without any point has an empty list.
    """
    images = [
        {"id": k, "file_name": f"clip/img_{frame:06d}.png", "width": size[0], "height": size[1]}
        for k, frame in enumerate(frames)
    ]
    annotations = []
    for k in range(len(frames)):
        for points, score in zip(positions[k], confidence[k], strict=True):
            known = np.isfinite(points[:, :1])
            triples = np.where(known, np.column_stack([points, score]), 0.0).ravel().tolist()
            entry = {"id": len(annotations), "image_id": k, "category_id": 1}
            annotations.append(entry | {"keypoints": triples if known.any() else []})
    categories = [{"id": 1, "name": "subject", "keypoints": list(names)}]
    return {"images": images, "annotations": annotations, "categories": categories} | changes


def coco_bytes(*args, **kwargs):
    return json.dumps(coco(*args, **kwargs)).encode()


def dlc_columns(names, individuals=("",), likelihood=True):
    coords = ("x", "y", "likelihood")[: 2 + likelihood]
    return [
        ("net", *([who] if who else []), name, coord)
        for who in individuals
        for name in names
        for coord in coords
    ]


def dlc_values(positions, confidence, likelihood=True):
    """Return `[frame, column]` values in the order of `dlc_columns`."""
    triples = np.concatenate([positions, confidence[..., None]], -1)[..., : 2 + likelihood]
    return triples.reshape(len(positions), -1)


def dlc_levels(columns):
    return (
        ["scorer", "individuals", "bodyparts", "coords"]
        if len(columns[0]) == 4
        else ["scorer", "bodyparts", "coords"]
    )


def dlc_csv(rows, columns, values, index_columns=1):
    """Return the text of a .csv.

    rows: frame numbers or paths, which fill `index_columns` cells.
    """
    header = zip(dlc_levels(columns), zip(*columns, strict=True), strict=True)
    lines = [",".join([level, *[""] * (index_columns - 1), *labels]) for level, labels in header]
    for row, cells in zip(rows, values, strict=True):
        lines.append(
            ",".join([str(row), *("" if np.isnan(cell) else repr(float(cell)) for cell in cells)])
        )
    return "\n".join(lines) + "\n"


def _index(rows):
    return np.array(rows) if isinstance(rows[0], int) else np.array(rows, dtype="S")


def dlc_h5_table(path, rows, columns, values, key="df_with_missing", labels=None):
    """Write the layout of `to_hdf(format="table")`, which has labels as pickles in attributes.

    labels: takes the place of the columns' pickle.
    """
    index = _index(rows)
    with h5py.File(path, "a") as file:
        group = file.create_group(key)
        group.attrs["pandas_type"] = np.bytes_(b"frame_table")
        group.attrs["info"] = np.bytes_(
            pickle.dumps({1: {"names": dlc_levels(columns), "type": "MultiIndex"}, "index": {}}, 0)
        )
        content = np.zeros(
            len(rows), dtype=[("index", index.dtype), ("values_block_0", "<f8", (len(columns),))]
        )
        content["index"], content["values_block_0"] = index, values
        table = group.create_dataset("table", data=content)
        table.attrs["values_block_0_kind"] = np.bytes_(
            pickle.dumps(list(columns), 0) if labels is None else labels
        )


def dlc_h5_fixed(path, rows, columns, values, key="predictions"):
    """Write the layout of `to_hdf(format="fixed")`, which has labels as levels and codes."""
    with h5py.File(path, "a") as file:
        group = file.create_group(key)
        group.attrs["pandas_type"] = np.bytes_(b"frame")
        for name in ("axis0", "block0_items"):
            _codes(group, name, columns, dlc_levels(columns))
        if isinstance(rows[0], tuple):
            _codes(group, "axis1", rows, ["N."] * len(rows[0]))
        else:
            group["axis1"] = _index(rows)
        group["block0_values"] = values
        group["block0_values"].attrs["transposed"] = 1


def _codes(group, name, entries, levels):
    for k, (level, labels) in enumerate(zip(levels, zip(*entries, strict=True), strict=True)):
        known = sorted(set(labels))
        group[f"{name}_level{k}"] = np.array(known, dtype="S")
        group[f"{name}_level{k}"].attrs["name"] = np.bytes_(level.encode())
        group[f"{name}_label{k}"] = np.array(
            [known.index(label) for label in labels], dtype=np.int8
        )
