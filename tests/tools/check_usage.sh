#!/usr/bin/env bash
# Every subcommand with no, wrong, repeated and huge arguments, with files that are missing, no
# files or not theirs, with outputs that exist or cannot be written, and with little memory: the
# exit code is the documented one, and what existed is as it was.
#   check_usage.sh path/to/nmp [sanitized]
set -u
sanitized=${2-}
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

# 0. A small project to try them on.
tiny=(--set mesh.vertices_per_edge=2 --set time.frames=24 --set time.dt=1e-4 --set time.substeps=5
  --set dataset.train=2 --set dataset.validation=1 --set initial.clearance=0.001)
quick=(--set train.constitutive.iterations=3 --set train.constitutive.batch=64
  --set train.integration.iterations=2 --set train.integration.batch=64
  --set train.integration.fit_window=6 --set train.integration.window_start=4
  --set train.integration.window_end=8 --set train.joint.iterations=0
  --set "model.stress.hidden=[2]" --set model.integration.hidden=2
  --set model.integration.embedding=2 --set "model.integration.alignment_widths=[2,2,2]")
expect 0 data gen cube -o d "${tiny[@]}"
expect 0 train fast --data d -o m "${quick[@]}"
expect 0 eval --model m --data d --json
cp stdout eval.json
analytic=(--data d --constitutive stvk --integrator semi-implicit)
expect 0 rollout "${analytic[@]}" -o r
expect 0 report --model m --data d --eval eval.json -o p.html
expect 0 view d -o v.html
cp m m.kept && cp r r.kept && cp p.html p.kept && cp v.html v.kept && cp d/manifest.json manifest.kept
cp m.metrics.jsonl metrics.kept
expect 0 mesh box -o box.msh --size 1,1,1 --cells 2,2,2
expect 0 mesh surface box.msh -o box.stl

# 1. Every command, with arguments that make sense for it but for one.
declare -A complete=(
  ["data gen"]="cube -o new --set time.frames=1"
  ["data import"]="--gravity 0,0,0 --ground none -o new r"
  ["data info"]="d"
  ["data verify"]="d"
  ["train"]="fast --data d -o new"
  ["rollout"]="--model m --data d"
  ["export"]="r --data d -o new"
  ["eval"]="--model m --data d"
  ["fit"]="--data d --length 8"
  ["report"]="--model m --data d --eval eval.json -o new"
  ["view"]="--data d -o new"
  ["grad-check"]=""
  ["bench"]="--only svd"
  ["reproduce table1"]="--scenes cube --scale smoke"
  ["model info"]="m"
  ["config list"]=""
  ["config scene"]="cube"
  ["config train"]="fast"
  ["mesh check"]="box.stl"
  ["mesh tet"]="box.stl -o new.msh"
  ["mesh box"]="-o new.msh --size 1,1,1 --cells 2,2,2"
  ["mesh surface"]="box.msh -o new.stl"
)
huge=$(head -c 100000 /dev/zero | tr '\0' x)
escape=$'\e[31mred'
values=('' -1 x 1e99 99999999999999999999999 nan)
settings=('' = =1 a..b=1 no.such.key=1 "$huge=1" "$escape=1" 'seed=[[[')
# A sanitized program takes half a second to start: less of what the parser of options alone sees.
if [ -n "$sanitized" ]; then
  values=(99999999999999999999999)
  settings=(a..b=1 "$huge=1" 'seed=[[[')
fi
for command in "${!complete[@]}"; do
  read -ra name <<<"$command"
  read -ra rest <<<"${complete[$command]}"
  expect 2 "${name[@]}" "${rest[@]}" --no-such-option
  expect 2 "${name[@]}" "${rest[@]}" --"$huge"
  stray=2
  [ "$command" != view ] || stray=5  # any word may be a file that is to be shown
  expect $stray "${name[@]}" "${rest[@]}" "$escape"
  expect 2 "${name[@]}" "${rest[@]}" --json=maybe
  expect $stray "${name[@]}" "${rest[@]}" extra words "$huge"
  for option in --threads --seed --horizons --frames --trajectory --trajectories --max-minutes \
    --seconds --repetitions --vertices; do
    for value in "${values[@]}"; do
      expect 2 "${name[@]}" "${rest[@]}" $option "$value"
    done
  done
  for setting in "${settings[@]}"; do
    expect 2 "${name[@]}" "${rest[@]}" --set "$setting"
  done
  # Options that take one value, twice; a value that is missing.
  for option in --model --data -o --split --stage --title --threads --seed; do
    [ -z "$sanitized" ] || continue
    expect 2 "${name[@]}" "${rest[@]}" $option
    expect 2 "${name[@]}" "${rest[@]}" $option 1 $option 1
  done
  case $command in
    grad-check | bench | reproduce* | "config list") ;;
    *) expect 2 "${name[@]}" ;;
  esac
  for file in new new.msh new.stl; do
    [ ! -e $file ] || complain "nmp $command: a refused command line left a file"
  done
done
expect 2 "$huge"
expect 2 data "$huge"
expect 2 ''
expect 2 --set a=b

# 2. Inputs that are missing, folders, pipes, devices, empty, of another kind.
mkdir folder && mkfifo pipe && : >empty && echo '{' >brace
head -c 100 m >cut
input() {  # the code for it, what stands before it, what after
  local code=$1 before=$2 after=$3
  local read_before read_after
  read -ra read_before <<<"$before"
  read -ra read_after <<<"$after"
  for file in missing folder pipe /dev/zero "$escape"; do
    expect 5 "${read_before[@]}" "$file" "${read_after[@]}"
  done
  for file in empty brace cut; do
    expect "$code" "${read_before[@]}" "$file" "${read_after[@]}"
  done
}
input 3 "eval --data d --model" ""
input 3 "rollout --data d --model" ""
input 3 "grad-check --model" ""
input 3 "export --data d -o new" ""
input 3 "report --data d --eval eval.json -o new --model" ""
input 3 "report --data d --model m -o new --eval" ""
input 3 "view --data d -o new --model" ""
input 3 "view --data d -o new" ""
input 3 "train fast --data d -o new --model" ""
for file in folder pipe /dev/zero; do
  expect 5 train "$file" --data d -o new
  expect 5 data gen "$file" -o new
done
for file in missing "$escape" brace cut; do
  expect 2 train "$file" --data d -o new
  expect 2 data gen "$file" -o new
done
for file in missing pipe /dev/zero folder "$escape" m; do
  for command in "data info" "data verify" "eval --model m --data" "rollout --model m --data" \
    "fit --data" "export -o new --data" \
    "report --model m -o new --data" "view -o new --data" "train fast -o new --data"; do
    read -ra words <<<"$command"
    expect 5 "${words[@]}" "$file"
  done
done
expect 3 eval --model r --data d && says "not a model"
expect 3 report --model m --data d --eval eval.json --metrics eval.json -o new && says "metrics"
expect 3 report --model m --data d --eval m.metrics.jsonl -o new && says "evaluation 1"
if [ "$(id -u)" -ne 0 ]; then
  cp m secret && chmod 000 secret
  expect 5 eval --model secret --data d && says "permission"
else
  echo "skipped: files without permission, since root may read them"
fi
[ ! -e new ] || complain "a refused input left a file"

# 3. Damage in a dataset is found by verify, all of it, and gen repairs it.
cp -r d damaged
printf 'x' | dd of=damaged/train/000.safetensors bs=1 seek=900 conv=notrunc 2>/dev/null
rm damaged/val/000.safetensors
expect_problems() {
  timeout 60 "$nmp" data verify damaged >stdout 2>stderr
  [ $? -eq 3 ] || complain "damage in a dataset is not exit code 3"
  [ "$(wc -l <stdout)" -ge "$1" ] || complain "verify does not list $1 problems"
}
expect_problems 2
grep -q "^train/000.safetensors: expected the checksum" stdout || complain "the flipped byte"
grep -q "^val/000.safetensors: " stdout || complain "the missing file"
says "nmp data gen"
expect 0 data gen damaged/scene.toml -o damaged
expect 0 data verify damaged
cmp -s d/train/000.safetensors damaged/train/000.safetensors || complain "gen made another file"

# 4. Outputs: what exists is kept without --force; what cannot be written is an error.
expect 2 data gen cube -o d "${tiny[@]}" --set material.E=1e4 && says "--force"
expect 2 data gen cube -o folder/../. "${tiny[@]}" && says "--force"
expect 2 train fast --data d -o m "${quick[@]}" && says "--force"
expect 2 rollout "${analytic[@]}" -o r && says "--force"
expect 2 report --model m --data d --eval eval.json -o p.html && says "--force"
expect 2 view d -o v.html && says "--force"
ln -s nowhere link
for output in folder pipe link; do
  expect 2 rollout "${analytic[@]}" -o $output && says "--force"
  expect 2 report --model m --data d --eval eval.json -o $output
  expect 2 view d -o $output
done
for output in pipe link brace; do expect 2 export --data d -o $output && says "--force"; done
expect 5 export --data d -o pipe --force
expect 5 export --data d -o no/such/folder
expect 2 export --data d -o . && expect 2 export --data d -o d --force && says "would be lost"
expect 5 rollout "${analytic[@]}" -o folder --force
expect 5 rollout "${analytic[@]}" -o pipe --force
expect 5 rollout "${analytic[@]}" -o no/such/folder
expect 5 report --model m --data d --eval eval.json -o no/such/folder
expect 5 data gen cube -o brace/d "${tiny[@]}"
expect 5 train fast --data d -o no/such/folder "${quick[@]}"
cmp -s m m.kept && cmp -s r r.kept && cmp -s p.html p.kept && cmp -s v.html v.kept && cmp -s m.metrics.jsonl metrics.kept &&
  cmp -s d/manifest.json manifest.kept || complain "a result changed without --force"
[ -p pipe ] && [ -L link ] && [ -d folder ] || complain "a pipe, link or folder was replaced"

# 5. A result that cannot be delivered.
for arguments in --help --version "data --help" "data info d" "data verify d" "grad-check --json" \
  "bench --only svd --seconds 0 --repetitions 1" \
  "eval --model m --data d --methods rest" "rollout --data d --constitutive stvk --integrator semi-implicit"; do
  read -ra words <<<"$arguments"
  "$nmp" "${words[@]}" >&- 2>stderr
  [ $? -eq 5 ] || complain "nmp $arguments, stdout closed: not exit code 5"
  if [ -w /dev/full ]; then
    "$nmp" "${words[@]}" >/dev/full 2>stderr
    [ $? -eq 5 ] || complain "nmp $arguments, disk full: not exit code 5"
  fi
  runs=$((runs + 2))
done

# 6. A rollout that blows up keeps its frames, and says where.
expect 4 rollout --data d --constitutive neo-hookean --integrator semi-implicit --E 1e12 -o blown
says "largest speed" && says "element" && says "the frames before are in blown"
[ -s blown ] || complain "the frames before a divergence were not kept"
expect 4 rollout --data d --constitutive neo-hookean --integrator semi-implicit --E 1e12 && says "-o"

# 7. Memory that is not there. Sanitizers reserve more than they are given.
if [ -z "$sanitized" ]; then
  scarce() { (ulimit -v 600000 && OMP_NUM_THREADS=1 exec "$nmp" "$@") >stdout 2>stderr; }
  scarce data info d
  [ $? -eq 0 ] || complain "600 MB are not enough for a small dataset"
  scarce data gen cube -o large --set mesh.vertices_per_edge=300
  [ $? -eq 6 ] || complain "a mesh without memory for it: not exit code 6"
  says "memory"
  scarce train fast --data d -o large.st --set "model.stress.hidden=[65536, 65536]"
  [ $? -eq 6 ] || complain "a net without memory for it: not exit code 6"
  [ ! -e large.st ] || complain "a training without memory left a file"
  truncate -s 5G sparse
  scarce eval --model sparse --data d
  code=$?
  { [ $code -eq 3 ] || [ $code -eq 5 ]; } || complain "a sparse file of 5 GB: exit code $code"
else
  echo "skipped: scarce memory, since the sanitizers need more"
fi

finish "$runs command lines, all as documented"
