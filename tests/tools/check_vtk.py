"""What nmp export writes, read by VTK's and meshio's own readers, is what the recording holds.
  check_vtk.py RECORD H N:PVD...    each collection shows every N-th frame of the record
  check_vtk.py rewrite PVD FOLDER   the same frames as VTK's own writer encodes them
  check_vtk.py same RECORD RECORD   two records hold the same positions, velocities and forces"""
import json
import os
import struct
import sys

import meshio
import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy


def read_safetensors(path):
    with open(path, "rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
        data = file.read()
    kinds = {"F32": "<f4", "F64": "<f8", "I32": "<i4"}
    return {
        name: np.frombuffer(data[slice(*entry["data_offsets"])], kinds[entry["dtype"]]).reshape(entry["shape"])
        for name, entry in header.items()
        if name != "__metadata__"
    }


def read_vtu(path):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    arrays = {}
    for data in (grid.GetPointData(), grid.GetCellData()):
        for k in range(data.GetNumberOfArrays()):
            arrays[data.GetArrayName(k)] = vtk_to_numpy(data.GetArray(k))
    return vtk_to_numpy(grid.GetPoints().GetData()), vtk_to_numpy(grid.GetCells().GetConnectivityArray()), arrays


def det_F(rest, x, tets):
    edges = lambda p: np.stack([p[tets[:, k]] - p[tets[:, 0]] for k in (1, 2, 3)], axis=1)
    return np.linalg.det(edges(x.astype(float))) / np.linalg.det(edges(rest))


def check(collection, record, h, every):
    xml = vtk.vtkXMLDataParser()
    xml.SetFileName(collection)
    assert xml.Parse(), collection
    entries = xml.GetRootElement().FindNestedElementWithName("Collection")
    n = entries.GetNumberOfNestedElements()
    assert n == (len(record["x"]) - 1) // every + 1, n
    folder = os.path.dirname(collection)
    for k in range(n):
        entry, t = entries.GetNestedElement(k), k * every
        assert abs(float(entry.GetAttribute("timestep")) - t * h) <= 1e-12 * max(1, t), t
        path = os.path.join(folder, entry.GetAttribute("file"))
        x, tets, arrays = read_vtu(path)
        if k == 0:
            rest, rest_tets, rest_arrays = read_vtu(os.path.join(os.path.dirname(path), "rest.vtu"))
            assert rest.dtype == np.float64 and set(np.unique(rest_arrays["pinned"])) <= {0, 1}
            names = set(arrays)
        assert set(arrays) == names >= {"v", "f_int", "det_F"}, set(arrays)
        tets = tets.reshape(-1, 4)
        assert (tets == rest_tets.reshape(-1, 4)).all()
        assert x.dtype == np.float32 and (x == record["x"][t]).all(), t
        assert (arrays["v"] == record["v"][t]).all() and (arrays["f_int"] == record["f_int"][t]).all(), t
        assert np.allclose(arrays["det_F"], det_F(rest, x, tets), rtol=1e-5), t
        other = meshio.read(path)
        assert (other.points == x).all() and (other.cells_dict["tetra"] == tets).all()
        assert (other.point_data["v"] == arrays["v"]).all()
    return names


def rewrite(collection, folder):
    os.makedirs(folder)
    with open(collection) as file:
        text = file.read()
    with open(os.path.join(folder, "run.pvd"), "w") as file:
        file.write(text)
    for k, name in enumerate(sorted(os.listdir(os.path.dirname(collection)))):
        if not name.endswith(".vtu"):
            continue
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(os.path.join(os.path.dirname(collection), name))
        reader.Update()
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetFileName(os.path.join(folder, name))
        writer.SetInputData(reader.GetOutput())
        if k % 3 == 1:
            writer.SetDataModeToBinary()
        if k % 3 == 2:
            writer.EncodeAppendedDataOff()
            writer.SetByteOrderToBigEndian()
        assert writer.Write() == 1


if __name__ == "__main__" and sys.argv[1] == "rewrite":
    rewrite(*sys.argv[2:])
elif __name__ == "__main__" and sys.argv[1] == "same":
    a, b = map(read_safetensors, sys.argv[2:])
    assert all((a[name] == b[name]).all() for name in ("x", "v", "f_int"))
elif __name__ == "__main__":
    record = read_safetensors(sys.argv[1])
    h = float(sys.argv[2])
    for argument in sys.argv[3:]:
        every, collection = argument.split(":")
        print(collection, *sorted(check(collection, record, h, int(every))))
