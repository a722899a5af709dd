#!/usr/bin/env bash
# Every example does what it says, and ends with a status that tells.
#   check_examples.sh NMP FOLDER-OF-THE-PROGRAMS MODELS-FOLDER
set -euo pipefail
nmp=$(realpath "$1") programs=$(realpath "$2") models=$(realpath "$3")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
export OMP_WAIT_POLICY=passive

"$nmp" mesh box --size 1,1,1 --cells 3,3,3 -o cube.msh >/dev/null
"$nmp" mesh box --size 1,0.2,0.2 --cells 10,2,2 -o beam.msh >/dev/null
run() { echo "\$ $(basename "$1") ${*:2}"; "$@"; }

run "$programs/minimal" cube.msh
run "$programs/minimal" cube.msh "$models/cube.safetensors" | tee learned
# It has fallen from 0.5 m above the ground, and does not go through it.
awk '/lowest/ { z = $(NF - 1); if (z < -1.0001) exit 1; if (z < low) low = z }
     END { exit !(low < -0.9) }' learned
run "$programs/host_loop" cube.msh
run "$programs/custom_material" beam.msh
run "$programs/aim" cube.msh | tail -n 1
for wrong in minimal host_loop custom_material aim; do
  if "$programs/$wrong" missing.msh 2>error; then echo "$wrong takes a missing mesh" >&2; exit 1; fi
  grep -q missing.msh error || { echo "$wrong does not name the missing mesh" >&2; exit 1; }
done
