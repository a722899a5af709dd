#!/usr/bin/env bash
# nmp export and nmp data import beside VTK and meshio. Exit 77 without Debian's python3-vtk9 and
# python3-meshio.
#   check_vtk.sh path/to/nmp
set -u
script=$(realpath "$(dirname "${BASH_SOURCE[0]}")/check_vtk.py")
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

/usr/bin/python3 -c "import vtk, meshio" 2>stderr ||
  { echo "skipped: no VTK (apt-get install python3-vtk9 python3-meshio)"; exit 77; }
expect 0 data gen cube -o d --set mesh.vertices_per_edge=4 --set time.frames=30 \
  --set dataset.train=1 --set dataset.validation=1 --set initial.clearance=0.001
expect 0 export --data d -o plain
expect 0 export --data d -o packed.pvd --every 7 --zlib --stress
/usr/bin/python3 "$script" d/val/000.safetensors 0.0005 1:plain/frames.pvd 7:packed.pvd \
  >stdout 2>stderr || complain "VTK or meshio read something else"
[ "$(cat stdout)" = "plain/frames.pvd det_F f_int v
packed.pvd det_F energy f_int v von_mises" ] || complain "the arrays are $(cat stdout)"
# The check itself can fail: of another recording it says so.
/usr/bin/python3 "$script" d/train/000.safetensors 0.0005 1:plain/frames.pvd >stdout 2>stderr &&
  complain "another recording passes the check"
# VTK writes them again, in three encodings: they come back to the last bit.
/usr/bin/python3 "$script" rewrite plain/frames.pvd vtk 2>stderr || complain "VTK wrote nothing"
expect 0 data import vtk/run.pvd --gravity 0,0,-9.8 --ground 0 -o back
/usr/bin/python3 "$script" same d/val/000.safetensors back/train/000.safetensors 2>stderr ||
  complain "what VTK has written is read as something else"
finish "as VTK and meshio read it"
