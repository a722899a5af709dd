#!/usr/bin/env bash
# Meshes of one's own: nmp mesh, nmp data gen --mesh. Exit codes, standard streams, files. What
# needs tetgen or gmsh is skipped where they are not installed.
#   check_mesh_cli.sh path/to/nmp
#   check_mesh_cli.sh path/to/nmp bodies    # BOB and SPOT instead; exit 77 if NMP_MESHES lacks them
set -u
meshes=$(realpath -m "${NMP_MESHES:-no_meshes}")
unset NMP_MESHES
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

tiny=(--set time.frames=24 --set time.dt=1e-4 --set time.substeps=5 --set dataset.train=2
  --set dataset.validation=1)

# 0. BOB and SPOT, in both of their formats.
check_bodies() {
  for body in bob spot bob_fine; do
    expect 0 mesh check "$meshes/$body.msh" && prints "nothing wrong"
    expect 0 mesh convert "$meshes/$body.msh" $body-msh.vtu --binary
    expect 0 mesh convert "$meshes/$body.node" $body-node.vtu --binary
    cmp -s $body-msh.vtu $body-node.vtu || complain "$body.msh and $body.node differ"
  done
  expect 0 data gen --mesh bob.msh --meshes "$meshes" -o bob "${tiny[@]}" --set mesh.up=y \
    --set contact.ground=none --set 'pins.planes=[[0, 0, 1, 0.25]]'
  expect 0 data info bob && prints "43 pinned"
  expect 0 data gen --mesh spot.ele --meshes "$meshes" -o spot "${tiny[@]}" --set mesh.up=y \
    --set contact.ground=none --set 'pins.planes=[[0, -1, 0, 0.93]]'
  expect 0 data info spot && prints "22 pinned"
}
if [ "${2-}" = bodies ]; then
  [ -e "$meshes/bob.msh" ] || { echo "skipped: set NMP_MESHES to the folder of BOB and SPOT"; exit 77; }
  check_bodies
  finish "all as promised"
fi

# Two tets, the second one inverted, and a vertex that neither has.
cat >body.node <<'END'
6 3 0 0
0 0 0 0
1 1 0 0
2 0 1 0
3 0 0 1
4 1 1 1.5
5 9 9 9
END
cat >body.ele <<'END'
2 4 0
0 0 1 2 3
1 4 1 2 3
END
# A flat tet.
printf '4 3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 1 1 0\n' >flat.node
printf '1 4\n1 1 2 3 4\n' >flat.ele

# 1. Help, and command lines that are wrong.
for command in mesh "mesh info" "mesh check" "mesh convert" "mesh tet" "mesh box" "mesh surface"; do
  # shellcheck disable=SC2086
  expect 0 $command --help && prints "Example"
  grep -q '^  nmp ' stdout || complain "nmp $command --help has no example line"
done
expect 2 mesh && says "tet, box, surface, info, check, convert" && silent
expect 2 mesh chekc body.node && says "did you mean check?"
expect 2 mesh info && says "FILE"
expect 2 mesh info body.stl && says ".msh (Gmsh), .node or .ele (TetGen), .vtk or .vtu" && says "nmp mesh tet" && silent
expect 2 mesh info body.node --scale 0
expect 2 mesh info body.node --up x
expect 2 mesh convert body.node && says "OUT"
expect 2 mesh convert body.node out.stl && says "'nmp mesh surface'"
expect 2 mesh convert cube.stl out.msh && says "'nmp mesh tet'"
expect 2 mesh convert cube.stl out.ply --gmsh2
expect 2 mesh tet cube.stl && says "output"
expect 2 mesh tet body.node -o x.msh && says ".obj, .stl or .ply" && says "nmp data gen --mesh"
expect 2 mesh tet cube.stl -o x.stl && says "the output is a mesh of tetrahedra"
expect 2 mesh tet cube.stl -o x.msh --size 1 --resolution 3
expect 2 mesh tet cube.stl -o x.msh --resolution 0
expect 2 mesh tet cube.stl -o x.msh --mesher cgal
expect 2 mesh box -o x.msh --size 1,1 --cells 1,1,1
expect 2 mesh box -o x.msh --size 1,1,1 --cells 1000000,1000000,1000000 && says "a box has 1 to"
expect 2 mesh box -o x.msh --size 1e100,1,1 --cells 2,2,2
expect 2 mesh box -o x.msh --size 1,1,0 --cells 1,1,1
expect 2 mesh box -o x.msh --size 1,1,1 --cells 1,1,1.5
expect 2 mesh surface body.node -o x.msh && says ".obj, .stl or .ply"
expect 5 mesh tet missing.stl -o x.msh && says "missing.stl"
expect 5 mesh info missing.msh && says "missing.msh"
printf '$MeshFormat\n3 0 8\n' >old.msh
expect 3 mesh info old.msh && says "old.msh:2: expected version 2.2 or 4.1" && silent

# 2. What a mesh is like.
expect 0 mesh info body.node && prints "tetrahedra" && prints "stable time step"
says "1 tet is inverted (1): turned" && says "1 vertex belongs to no tet (5): dropped"
expect 0 mesh info body.ele --json && is_json && prints '"n_vertices": 5'
expect 0 mesh info body.ele --json --no-step && prints '"stable_time_step": null'
expect 0 mesh info body.ele --scale 0.1 --up y --json && prints '0.1500000'
expect 3 mesh info flat.node && says "1 tet is flat (0)" && silent
expect 0 mesh check body.node && prints "can be repaired (--fix OUT): 1 tet is inverted (1)"
expect 0 mesh check body.node --json && is_json && prints '"usable": true'
expect 3 mesh check flat.node && prints "refused: 1 tet is flat (0)" && says "cannot be simulated"
expect 3 mesh check flat.node --json && is_json && prints '"usable": false'
expect 0 mesh check body.node --scale 1000 && prints "mesh.scale"

# 3. Every format into every other, and back to the first.
expect 0 mesh convert body.node good.msh --fix && prints "5 vertices, 2 tetrahedra"
expect 0 mesh check good.msh && prints "nothing wrong"
expect 2 mesh convert body.node good.msh && says "--force"
expect 0 mesh convert body.node good.msh --fix --force --json && is_json
from=good.msh step=0
for form in msh:--gmsh2 "msh:--gmsh2 --binary" msh:--binary vtk: vtk:--binary vtu: vtu:--binary node:; do
  to=step$((++step)).${form%%:*}
  # shellcheck disable=SC2086
  expect 0 mesh convert "$from" "$to" ${form#*:}
  from=$to
done
expect 0 mesh convert "$from" last.msh
cmp -s good.msh last.msh || complain "a mesh came back changed from a tour of the formats"
expect 2 mesh convert good.msh x.node --binary && says "text only"
expect 2 mesh convert good.msh step8.ele && says "step8.node: already exists"

# 4. Repair of a mesh, boxes, surfaces and back to a mesh.
expect 0 mesh check body.node --fix fixed.msh && prints "fixed.msh: written"
grep -q "^repaired: 1 tet is inverted (1)" stdout || complain "check --fix does not say what is repaired"
cmp -s good.msh fixed.msh || complain "check --fix and convert --fix differ"
expect 2 mesh check body.node --fix fixed.msh && says "--force" && silent
expect 3 mesh check flat.node --fix no.msh
expect 0 mesh box -o box.msh --size 1,0.5,0.25 --cells 8,4,2 && prints "135 vertices, 320 tetrahedra"
expect 0 mesh check box.msh && prints "nothing wrong"
expect 2 mesh box -o box.msh --size 1,0.5,0.25 --cells 8,4,2 && says "--force"
from=box.msh
for form in obj: ply: ply:--binary stl: stl:--binary; do
  expect 0 mesh surface box.msh -o "skin$((++step)).${form%%:*}" ${form#*:} && prints "224 triangles"
  from=skin$step.${form%%:*}
  expect 0 mesh check "$from" && prints "nothing wrong" && prints "can fill" && prints "0.125 m3"
  expect 0 mesh tet "$from" -o "filled$step.msh" --resolution 8 && prints "0.125 m3"
  cmp -s "filled$step.msh" "filled$((step - 1)).msh" || [ "$form" = obj: ] ||
    complain "the mesh of $from is another"
done
expect 2 mesh surface box.msh -o skin.obj --binary && says "text only"
expect 2 mesh surface box.msh -o "$from" && says "--force"
expect 0 mesh box -o $'x\xff.msh' --size 1,1,1 --cells 1,1,1 --json && is_json
expect 0 mesh convert "$from" turned.ply --scale 2 --up y --binary && prints "224 triangles"
expect 0 mesh check turned.ply && prints "1 m3"
expect 2 mesh convert "$from" -o turned.ply && says "--force"
expect 0 mesh convert turned.ply turned.stl --fix --json && is_json
expect 0 mesh tet "$from" -o one.vtu --json && is_json && prints '"n_parts": 1' && prints '"lost_area": 0.0'
expect 0 mesh tet "$from" -o two.vtu --threads 3 && cmp -s one.vtu two.vtu ||
  complain "the number of threads changes a mesh"
expect 2 mesh tet "$from" -o one.vtu && says "--force"
expect 2 mesh tet "$from" -o fine.msh --size 1e-5 && says "smaller --resolution"
expect 0 mesh tet "$from" -o mm.msh --scale 1000 --size 0.125 --json && prints '"cell": 125.0'
says "1 mm or above 100 m"
expect 0 data gen --mesh one.vtu -o filled "${tiny[@]}" && prints "tetrahedra"

# 5. Surfaces that are not as they should be.
cat >cube.obj <<'END'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
END
expect 0 mesh check cube.obj --json && is_json && prints '"closed": true' && prints '"usable": true'
prints "6 polygons are cut into triangles"
expect 0 mesh tet cube.obj -o cube.msh --resolution 4 && prints "1 m3" && says "6 polygons"
sed -i 's/^f 3 4 8 7$/f 7 8 4 3/' cube.obj
expect 0 mesh check cube.obj --fix mended.ply && prints "2 triangles are oriented against" && prints "(8, 9): turned"
expect 0 mesh check mended.ply && prints "nothing wrong"
sed -i '/^f 7 8 4 3$/d' cube.obj
expect 0 mesh check cube.obj && prints "warning: 4 triangles have an edge that no other has"
expect 0 mesh check cube.obj --ids 1 && prints "(0, ...)"
expect 0 mesh check cube.obj --all && prints "(0, 3, 6, 9)"
expect 0 mesh tet cube.obj -o open.msh && says "holes" && prints "tetrahedra"
sed -i '9,12d' cube.obj
expect 3 mesh check cube.obj --json && is_json && prints '"usable": false'
expect 3 mesh check cube.obj --fix no.ply && prints "refused: the surface does not enclose a body"
expect 3 mesh tet cube.obj -o no.msh && says "close its openings" && silent
: >empty.obj
expect 3 mesh tet empty.obj -o no.msh && says "no triangle"
printf 'solid\nfacet\n' >cut.stl
expect 3 mesh tet cut.stl -o no.msh && says "cut.stl:3: expected normal"
expect 0 mesh box -o plate.msh --size 1,1,0.001 --cells 4,4,1
expect 0 mesh surface plate.msh -o plate.stl
expect 3 mesh tet plate.stl -o no.msh --resolution 3 && says "raise --resolution above 3" && silent
expect 3 mesh tet plate.stl -o no.msh --size 0.34 && says "lower --size"
[ ! -e no.msh ] && [ ! -e no.ply ] || complain "a refused surface left a file"

# 6. Meshers that are installed, that fail, that are not there.
mkdir temporary && export TMPDIR=$PWD/temporary
mkdir fake && printf '#!/bin/sh\necho boom\nexit 7\n' >fake/tetgen && cp fake/tetgen fake/gmsh
chmod +x fake/*
printf '#!/bin/sh\nPATH=/nowhere exec "%s" "$@"\n' "$nmp" >without_path && chmod +x without_path
for mesher in tetgen gmsh; do
  if command -v $mesher >/dev/null; then
    expect 0 mesh tet "$from" -o $mesher.msh --mesher $mesher --size 0.1 && prints "0.125 m3"
    expect 0 mesh check $mesher.msh
  else
    skip "$mesher is not installed"
  fi
  PATH=$PWD/fake:$PATH expect 3 mesh tet "$from" -o no.msh --mesher $mesher
  says "exit status 7 and 'boom"
  nmp=$PWD/without_path expect 2 mesh tet "$from" -o no.msh --mesher $mesher
  says "on Debian the package is called $mesher"
done
[ ! -e no.msh ] || complain "a mesher that failed left a file"
compgen -G "$TMPDIR/nmp_*" >/dev/null && complain "a temporary folder was left"

# 7. Datasets.
expect 2 data gen -o d && says "--mesh" && silent
expect 2 data gen --mesh missing.msh -o d && says "looked for 'missing.msh'" && says "NMP_MESHES"
expect 2 data gen --mesh good.stl -o d
expect 3 data gen --mesh flat.node -o d && says "1 tet is flat (0)"
[ ! -e d ] || complain "a refused mesh left a folder"
expect 0 data gen --mesh body.node -o d "${tiny[@]}" && prints "5 vertices, 2 tetrahedra"
says "warning: body.node: 1 tet is inverted (1)"
grep -q '^name = "body"$' d/scene.toml || complain "the scene is not named after the mesh"
expect 0 data gen --mesh ./body.node -o d "${tiny[@]}"
expect 0 data gen --mesh body.node -o scaled "${tiny[@]}" --scale 0.5 --up y
grep -q '^scale = 0.5' scaled/scene.toml && grep -q '^up = "y"' scaled/scene.toml ||
  complain "--scale and --up of data gen are not in the scene"
expect 2 data gen cube -o q --scale 0.5 && says "--mesh"
cp body.node kept && sed -i 's/1.5$/1.75/' body.node
expect 2 data gen --mesh body.node -o d "${tiny[@]}" && says "holds data of another mesh: body.node"
cp kept body.node
expect 0 data gen --mesh body.node -o p "${tiny[@]}" --set 'pins.boxes=[[0, 0, 0, 1, 1, 0]]' --json
is_json
expect 0 data info p && prints "3 pinned"
expect 2 data gen --mesh body.node -o q --set 'pins.spheres=[[9, 9, 9, 0.1]]' &&
  says "pins.spheres: rule 0, counted from 0, pins no vertex"
expect 2 data gen --mesh body.node -o q --set 'pins.planes=[[0, 0, 1, 0]]' && says "all 5 vertices"
expect 2 data gen --mesh body.node -o q --set 'pins.planes=[[0, 0, 1, 1]]' --set mesh.up=y \
  --set contact.ground=1 && says "contact.ground"
mkdir -p store scenes && cp good.msh store/stored.msh
printf '[mesh]\nfile = "stored.msh"\n' >scenes/mine.toml
expect 2 data gen scenes/mine.toml -o s "${tiny[@]}" && says "'scenes/stored.msh'"
expect 0 data gen scenes/mine.toml -o s "${tiny[@]}" --meshes store
NMP_MESHES=store expect 0 data gen scenes/mine.toml -o s "${tiny[@]}"
expect 0 data gen cube --mesh store/stored.msh -o c "${tiny[@]}" && prints "2 tetrahedra"

# 8. From there on no mesh file is needed.
rm -rf store scenes ./*.msh ./*.node ./*.ele
quick=(--set train.constitutive.iterations=3 --set train.constitutive.batch=16
  --set train.integration.iterations=2 --set train.integration.batch=16
  --set train.integration.fit_window=6 --set train.integration.window_start=4
  --set train.integration.window_end=8 --set train.joint.iterations=1
  --set train.joint.reset_start=8 --set train.joint.reset_end=8)
expect 0 train fast --data p -o m.safetensors "${quick[@]}"
expect 0 eval --model m.safetensors --data p --json && is_json
expect 0 rollout --model m.safetensors --data p -o r.safetensors
expect 0 report --model m.safetensors --data p -o r.html

finish "all as promised"
