#!/usr/bin/env bash
# Files that nmp mesh writes, read by Debian's meshio, and the other way round. Exit code 77 where
# meshio is not installed.
#   check_meshio.sh path/to/nmp
set -u
python=/usr/bin/python3
$python -c 'import meshio' 2>/dev/null || {
  echo "skipped: python3-meshio is not installed"
  exit 77
}
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

expect 0 mesh box -o box.msh --size 1,0.5,0.25 --cells 4,2,1
for surface in skin.obj skin.stl skin.ply; do expect 0 mesh surface box.msh -o $surface; done
for surface in skin_b.stl skin_b.ply; do expect 0 mesh surface box.msh -o $surface --binary; done
expect 0 mesh tet skin.ply -o filled.msh --resolution 8
for mesh in filled.vtu filled.vtk; do expect 0 mesh convert filled.msh $mesh; done

cat >check.py <<'END'
import sys, meshio, numpy as np

def volume_of_surface(m):
    x = m.points[m.cells_dict["triangle"]]
    return np.einsum("ij,ij->i", x[:, 0], np.cross(x[:, 1], x[:, 2])).sum() / 6

def volume_of_tets(m):
    x = m.points[m.cells_dict["tetra"]]
    v = np.einsum("ij,ij->i", np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), x[:, 3] - x[:, 0]) / 6
    assert (v > 0).all(), "inverted tets"
    return v.sum()

for name in ["skin.obj", "skin.stl", "skin.ply", "skin_b.stl", "skin_b.ply"]:
    m = meshio.read(name)
    assert len(m.cells_dict["triangle"]) == 56, name
    assert len(np.unique(m.points, axis=0)) == 30, name
    assert abs(volume_of_surface(m) - 0.125) < 1e-6, name
meshes = [meshio.read(name) for name in ["filled.msh", "filled.vtu", "filled.vtk"]]
for m in meshes:
    assert abs(volume_of_tets(m) - 0.125) < 1e-12
    assert (m.points == meshes[0].points).all()
    assert (m.cells_dict["tetra"] == meshes[0].cells_dict["tetra"]).all()

triangles = meshio.read("skin.obj")
for name, binary in [("w.stl", False), ("wb.stl", True), ("w.ply", False), ("wb.ply", True)]:
    meshio.write(name, triangles, binary=binary)
meshio.write("w.obj", triangles)
END
$python check.py >stdout 2>stderr || complain "meshio reads something else"
for surface in w.obj w.stl wb.stl w.ply wb.ply; do
  expect 0 mesh check $surface && prints "nothing wrong" && prints "56 triangles around 0.125 m3"
done
finish "meshio reads what is written, and what it writes is read"
