#!/usr/bin/env bash
# Meshes of one's own: nmp mesh, nmp data gen --mesh. Exit codes, standard streams, files.
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
for command in mesh "mesh info" "mesh check" "mesh convert"; do
  # shellcheck disable=SC2086
  expect 0 $command --help && prints "Example"
  grep -q '^  nmp ' stdout || complain "nmp $command --help has no example line"
done
expect 2 mesh && says "info, check, convert" && silent
expect 2 mesh chekc body.node && says "did you mean check?"
expect 2 mesh info && says "FILE"
expect 2 mesh info body.stl && says ".msh (Gmsh), .node or .ele (TetGen), .vtk or .vtu" && silent
expect 2 mesh info body.node --scale 0
expect 2 mesh info body.node --up x
expect 2 mesh convert body.node && says "OUT"
expect 2 mesh convert body.node out.stl
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
expect 0 mesh check body.node && prints "repaired: 1 tet is inverted (1)"
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

# 4. Datasets.
expect 2 data gen -o d && says "--mesh" && silent
expect 2 data gen --mesh missing.msh -o d && says "looked for 'missing.msh'" && says "NMP_MESHES"
expect 2 data gen --mesh good.stl -o d
expect 3 data gen --mesh flat.node -o d && says "1 tet is flat (0)"
[ ! -e d ] || complain "a refused mesh left a folder"
expect 0 data gen --mesh body.node -o d "${tiny[@]}" && prints "5 vertices, 2 tetrahedra"
says "warning: body.node: 1 tet is inverted (1)"
grep -q '^name = "body"$' d/scene.toml || complain "the scene is not named after the mesh"
expect 0 data gen --mesh ./body.node -o d "${tiny[@]}"
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

# 5. From there on no mesh file is needed.
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
