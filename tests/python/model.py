"""Checks a model that `onescan build` wrote as face.h5 and face.h5.json, with HDF5's own library:
every dataset, type, shape, attribute and text is what the reference engine writes.

Usage: model.py DIRECTORY VERTICES TRIANGLES RANK LANDMARKS
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

directory = Path(sys.argv[1])
vertices, triangles, rank, landmarks = map(int, sys.argv[2:])

FLOAT, INT = "<f4", "<i4"
PARTS = {"shape": "Shape", "color": "Color"}


def expected():
    """Path -> (type, shape, text or None)."""
    yield "version/majorVersion", (INT, (), 0)
    yield "version/minorVersion", (INT, (), 9)
    for name, path, kind in [
        ("MorphableModel", "/", "CUSTOM_MODEL"),
        ("MorphableModel.shape", "//shape", "POLYGON_MESH_MODEL"),
        ("MorphableModel.color", "/color", "POLYGON_MESH_DATA_MODEL"),
    ]:
        yield f"catalog/{name}/modelPath", ("text", (1,), path)
        yield f"catalog/{name}/modelType", ("text", (1,), kind)
    for part in PARTS:
        yield f"{part}/version/majorVersion", (INT, (), 0)
        yield f"{part}/version/minorVersion", (INT, (), 9)
        yield f"{part}/model/mean", (FLOAT, (3 * vertices,), None)
        yield f"{part}/model/noiseVariance", (FLOAT, (1,), None)
        yield f"{part}/model/pcaBasis", (FLOAT, (3 * vertices, rank), None)
        yield f"{part}/model/pcaVariance", (FLOAT, (rank,), None)
        yield f"{part}/modelinfo/build-time", ("text", (1,), None)
        yield f"{part}/modelinfo/scores", (FLOAT, (1, 1), None)
        yield f"{part}/representer/points", (FLOAT, (3, vertices), None)
        yield f"{part}/representer/cells", (INT, (3, triangles), None)
    yield "color/representer/colorspace", ("text", (1,), "RGB\0")
    yield "metadata/landmarks/json", ("text", (), None)


def check_text(where, kind, shape, text, size):
    assert isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str(), where
    assert kind.get_strpad() == h5py.h5t.STR_NULLTERM, where
    assert kind.get_cset() == h5py.h5t.CSET_ASCII, where
    assert shape in [(1,), ()], where
    assert text is None or kind.get_size() == size, (where, kind.get_size())


def check_file(path):
    """The binary file, by HDF5's library."""
    assert path.read_bytes()[8] == 0, "superblock 0"
    with h5py.File(path) as file:
        found = {}
        file.visititems(lambda name, o: found.update({name: o}))
        datasets = {n: o for n, o in found.items() if isinstance(o, h5py.Dataset)}
        wanted = dict(expected())
        assert set(datasets) == set(wanted), set(datasets) ^ set(wanted)
        for name, (kind, shape, value) in wanted.items():
            dataset = datasets[name]
            assert dataset.shape == shape, (name, dataset.shape)
            layout = dataset.id.get_create_plist().get_layout()
            assert layout == h5py.h5d.CONTIGUOUS and dataset.compression is None, name
            if kind == "text":
                size = None if value is None else len(value)
                check_text(name, dataset.id.get_type(), dataset.shape, value, size)
                assert value is None or dataset[0].decode() == value.rstrip("\0"), name
            else:
                assert dataset.dtype == np.dtype(kind), (name, dataset.dtype)
                assert np.isfinite(dataset[()]).all(), name
                assert value is None or dataset[()] == value, name
            assert not dataset.attrs, name
        groups = {n: o for n, o in found.items() if isinstance(o, h5py.Group)}
        for name, group in groups.items():
            part = name.split("/")[0]
            attributes = {}
            if name in [f"{part}/representer" for part in PARTS]:
                representer = f"gravis::Mesh{PARTS[part]}Representer"
                attributes = {"name": representer, "datasetType": "POLYGON_MESH"}
            assert set(group.attrs) == set(attributes), name
            for key, text in attributes.items():
                attribute = h5py.h5a.open(group.id, key.encode())
                check_text((name, key), attribute.get_type(), attribute.shape, text, len(text) + 1)
                assert group.attrs[key][0].decode() == text, (name, key)
        return {name: dataset[()] for name, dataset in datasets.items()}


def check_numbers(data):
    """What the numbers must be to one another."""
    points = data["shape/representer/points"]
    assert (data["color/representer/points"] == points).all()
    assert (data["shape/model/mean"].reshape(-1, 3).T == points).all(), "absolute points"
    cells = data["shape/representer/cells"]
    assert 0 <= cells.min() and cells.max() < vertices
    colors = data["color/model/mean"]
    assert 0 <= colors.min() and colors.max() <= 1
    for part in PARTS:
        basis = data[f"{part}/model/pcaBasis"].astype(float)
        error = abs(basis.T @ basis - np.eye(rank)).max()
        assert error < 1e-5, (part, "columns are orthonormal", error)
        variances = data[f"{part}/model/pcaVariance"]
        assert (variances > 0).all() and (np.diff(variances) <= 0).all(), part
    known = {tuple(p) for p in points.T.astype(float)}
    marks = json.loads(data["metadata/landmarks/json"])
    assert len(marks) == landmarks
    for mark in marks:
        assert tuple(mark["coordinates"]) in known, (mark, "is exactly a vertex")


def check_json(path, data):
    """The JSON file: the schema's parts, and the same values."""
    file = json.loads(path.read_text())
    found = {}

    def walk(group, path):
        for link in file["groups"][group]["links"]:
            assert link["class"] == "H5L_TYPE_HARD"
            below = f"{path}/{link['title']}".lstrip("/")
            if link["collection"] == "groups":
                assert file["groups"][link["id"]]["alias"] == [f"/{below}"]
                walk(link["id"], below)
            else:
                found[below] = file["datasets"][link["id"]]
                assert found[below]["alias"] == [f"/{below}"]

    walk(file["root"], "")
    assert set(found) == set(data)
    types = {FLOAT: ("H5T_FLOAT", "H5T_IEEE_F32LE"), INT: ("H5T_INTEGER", "H5T_STD_I32LE")}
    for name, (kind, shape, _) in expected():
        dataset = found[name]
        if kind == "text":
            assert dataset["type"]["class"] == "H5T_STRING", name
            assert dataset["type"]["length"] == "H5T_VARIABLE", name
            assert dataset["shape"] == {"class": "H5S_SCALAR"}, name
            text = data[name] if isinstance(data[name], bytes) else data[name][0]
            assert dataset["value"] == text.decode(), name
            continue
        assert (dataset["type"]["class"], dataset["type"]["base"]) == types[kind], name
        if shape:
            assert dataset["shape"] == {"class": "H5S_SIMPLE", "dims": list(shape)}, name
        else:
            assert dataset["shape"] == {"class": "H5S_SCALAR"}, name
        values = np.array(dataset["value"], dtype=kind)
        assert values.shape == shape and (values == data[name]).all(), name


data = check_file(directory / "face.h5")
check_numbers(data)
check_json(directory / "face.h5.json", data)
print(f"{len(data)} datasets are as the reference engine writes them (h5py {h5py.__version__})")
