"""Compares what `onescan fit --posterior` says of its samples with what ArviZ says of posterior.h5.

Usage: posterior.py DIRECTORY
"""

import json
import sys
from pathlib import Path

import arviz as az
import h5py

directory = Path(sys.argv[1])
with h5py.File(directory / "posterior.h5") as file:
    posterior = {name: values[:] for name, values in file["posterior"].items()}
    lp = file["sample_stats/lp"][:]
data = az.from_dict(posterior=posterior, sample_stats={"lp": lp})
found = json.loads((directory / "fit.json").read_text())["posterior"]
assert lp.shape == (found["chains"], found["draws"]), lp.shape
# The scene's names -> the file's.
color = [f"color.gain[{c}]" for c in range(3)] + ["color.contrast"]
color += [f"color.offset[{c}]" for c in range(3)]
places = {name: ("color", (i,)) for i, name in enumerate(color)}
places |= {f"pose.{name}": ("rotation", (i,)) for i, name in enumerate(["yaw", "pitch", "roll"])}
places["camera.focal_length"] = ("focal_length", ())


def place(name):
    if name in places:
        return places[name]
    kind, *indices = name.removeprefix("pose.").replace("]", "").split("[")
    return kind, tuple(map(int, indices))


rhat, bulk, tail = az.rhat(data), az.ess(data), az.ess(data, method="tail")
for parameter in found["parameters"]:
    kind, index = place(parameter["name"])
    for ours, theirs in [("r_hat", rhat), ("ess_bulk", bulk), ("ess_tail", tail)]:
        a, b = parameter[ours], float(theirs[kind].values[index])
        # The file's numbers are single, angles not in degrees: ranks may be tied there alone.
        assert abs(a / b - 1) < 1e-3, (parameter["name"], ours, a, b)
print(f"{len(found['parameters'])} parameters are diagnosed as by ArviZ {az.__version__}")
