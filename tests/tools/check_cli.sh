#!/usr/bin/env bash
# Exit codes, standard streams and files of the program.
#   check_cli.sh path/to/nmp
set -u
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

# 1. Help and version.
expect 0 --version && prints "nmp "
expect 0 --help && prints "Example"
for command in data "data gen" "data import" "data info" "data verify" train rollout export eval fit report view \
  grad-check bench reproduce "reproduce table1" "reproduce std" model "model info" config "config list" \
  "config scene" "config train" help completion; do
  # shellcheck disable=SC2086
  expect 0 $command --help && prints "Example"
  grep -qE '\[\]|=.* REQUIRED' stdout && complain "nmp $command --help has empty or needless defaults"
  grep -q '^  nmp ' stdout || complain "nmp $command --help has no example line"
done

# 2. Command lines that are wrong: 2, nothing on stdout, and a hint.
expect 2 && says "command" && silent
expect 2 trian && says "did you mean train?" && silent
expect 2 data && says "gen, import, info, verify"
expect 2 data inof && says "did you mean info?"
expect 2 eval --modle x && says "did you mean --model?" && silent
expect 2 eval && says "--model"
expect 2 eval --model a --model b --data d
expect 2 eval --model a --data d --threads 0
expect 2 eval --model a --data d --threads 99999999999999999999
expect 2 eval --model a --data d --horizons 1,x
expect 2 eval --model a --data d extra
expect 2 train fast --data d -o m --stage nothing
expect 2 train fast --data d -o m --stage joint && says "--model"
expect 2 rollout --data d && says "model"
expect 2 rollout --data d --model m --dt 1e-4 && says "semi-implicit"
expect 2 data gen no_such_scene -o d && says "cube"
expect 2 bench --only svdd && says "did you mean svd?" && silent
expect 2 bench --only nothing_like_it && says "ground_truth" && silent
expect 2 bench --vertices 5000 && says "--sweep"
expect 2 bench --seconds -1
expect 2 data gen "$(head -c 5000 /dev/zero | tr '\0' x)" -o d

# 3. Files that are missing (5) or not what they should be (3), and settings (2).
expect 5 data info no_such_folder && says "no_such_folder"
expect 5 eval --model no_such_model --data no_such_folder && says "no_such_model"
expect 5 grad-check --model no_such_model && silent
echo "not a model" >text && cp text text.pvd
expect 3 grad-check --model text && says "text"
mkdir -p wrong && echo "{" >wrong/manifest.json
expect 3 data info wrong && says "manifest.json"
printf 'name = "x"\n[time]\nframse = 3\n' >typo.toml
expect 2 data gen typo.toml -o typo && says "typo.toml:3" && says "frames"
[ ! -e typo ] || complain "a refused scene left a folder"
expect 2 data gen cube -o typo --set time.framse=3 && says "frames"

# 4. A whole small project; --json is one document.
tiny=(--set mesh.vertices_per_edge=3 --set time.frames=24 --set time.dt=1e-4 --set time.substeps=5
  --set dataset.train=2 --set dataset.validation=2 --set initial.clearance=0.001)
quick=(--set train.constitutive.iterations=3 --set train.constitutive.batch=64
  --set train.integration.iterations=2 --set train.integration.batch=64
  --set train.integration.fit_window=6 --set train.integration.window_start=4
  --set train.integration.window_end=8 --set train.joint.iterations=1
  --set train.joint.reset_start=8 --set train.joint.reset_end=8)
expect 0 data gen cube -o d "${tiny[@]}" --json && is_json
expect 0 data gen cube -o d "${tiny[@]}"
expect 2 data gen cube -o d "${tiny[@]}" --seed 2 && says "--force"
expect 0 data info d && prints "27 vertices"
expect 0 data verify d && prints "6 files, nothing wrong"
expect 0 data verify d --json && is_json
expect 0 data info d --json && is_json
expect 0 train fast --data d -o m.safetensors "${quick[@]}" --json && is_json
[ -s m.safetensors ] && [ -s m.metrics.jsonl ] || complain "train left no model or no metrics"
cp m.safetensors kept
expect 2 train fast --data d -o m.safetensors "${quick[@]}" && says "--force"
cmp -s m.safetensors kept || complain "a refused training touched the model"
expect 0 train fast --data d -o m.safetensors "${quick[@]}" --force && prints "joint"
cmp -s m.safetensors kept || complain "the same training gave another model"
expect 0 train fast --data d -o j.safetensors "${quick[@]}" --model m.safetensors --stage joint
expect 0 train fast --data d -o j.safetensors "${quick[@]}" --model m.safetensors --stage joint --resume &&
  says "complete"
expect 0 train fast --data d -o l.safetensors "${quick[@]}" --law m.safetensors --stage integration \
  --set 'model.integration.form="density"'
expect 0 model info l.safetensors --json && prints '"integrator": "density"'
learned_E=$(grep -m 1 '"E"' stdout)
expect 0 model info m.safetensors --json && prints "$learned_E"
expect 2 train fast --data d -o l2.safetensors --law m.safetensors --model m.safetensors
# Thrown five times as fast as in training, the body is strained as it never was.
expect 0 data gen cube -o fast "${tiny[@]}" --set "initial.v_min=[0, 0, -15]" --set "initial.v_max=[0, 0, -15]" \
  --set initial.clearance=0 --set dataset.train=0 --set dataset.validation=1
expect 0 rollout --model m.safetensors --data fast && says "go beyond the training's"
[ "$(grep -c "go beyond" stderr)" -eq 1 ] || complain "the warning of strains is not given once"
expect 0 eval --model m.safetensors --data d --json && is_json && cp stdout eval.json
expect 0 eval --model m.safetensors --data d --split validation && prints "neural"
expect 2 eval --model m.safetensors --data d --horizons 25 && says "24"
expect 2 eval --model m.safetensors --data d --methods nerual && says "neural"
expect 0 data gen cube -o hit "${tiny[@]}" --set initial.clearance=0.002 --set time.frames=60
expect 0 fit --data hit --params E --guess E=2e5,nu=0.45 --segments 4 --length 20 && prints "Pa"
expect 0 fit --data hit --params E,density --segments 4 --length 20 --json && is_json &&
  prints "E/density"
expect 2 fit --data hit --params mass && says "these are: E, nu"
expect 2 fit --data hit --guess E=stiff && says "NAME=VALUE"
expect 2 fit --data d && says "too few for segments"
expect 0 data gen cube -o falls "${tiny[@]}" --set initial.clearance=0.1 && says "--set initial.clearance=0.001"
expect 2 data gen body.msh -o none && says "--mesh FILE"
expect 3 fit --data falls --params E --length 5 && says "do not tell log E" && silent
expect 0 rollout --model m.safetensors --data d -o r.safetensors --json && is_json
expect 2 rollout --model m.safetensors --data d -o r.safetensors && says "--force"
expect 4 train fast --data falls -o none.safetensors "${quick[@]}" && says "motions that deform the body"
expect 2 rollout --model m.safetensors --data d --trajectory 2 && says "from 0"
expect 2 rollout --data d --constitutive stvk && says "--integrator semi-implicit"
expect 2 rollout --data d --constitutive stvk --integrator semi-implicit --dt 3e-4 && says "divide"
expect 2 rollout --data d --constitutive stvk --integrator semi-implicit --nu 0.5 && says "nu"
expect 0 rollout --data d --constitutive stvk --integrator semi-implicit --dt 1e-4 --frames 30
expect 4 rollout --data d --constitutive neo-hookean --integrator semi-implicit --E 1e12 \
  -o diverged.safetensors && says "after frame"
[ -s diverged.safetensors ] || complain "a rollout that diverged left no frames"
expect 3 rollout --model r.safetensors --data d && says "not a model"

# What is exported: what there is to see, from where, and nothing in the way of it.
expect 0 export --data d -o frames --json && is_json && prints '"record": null'
[ "$(find frames -name 'frame_*.vtu' | wc -l)" -eq 25 ] || complain "not a file for each frame"
[ "$(grep -c '<DataSet' frames/frames.pvd)" -eq 25 ] || complain "the collection lacks frames"
expect 2 export --data d -o frames && says "--force"
expect 2 export --data d -o one.obj && says "--format obj"
expect 2 export r.safetensors --data d --h 0.5 -o none && says "--h is for files that do not tell"
expect 0 export r.safetensors --data d -o frames --force --every 10 --stress &&
  prints "3 frames of r.safetensors, errors against val/000.safetensors"
grep -q 'Name="von_mises"' frames/frame_0020.vtu || complain "the frames lack stresses"
[ ! -e frames/frame_0001.vtu ] || complain "frames of an earlier export stayed"
expect 0 export r.safetensors --data hit -o other.pvd && says "no record of hit has this start"
expect 0 export --data d --split train --trajectory 1 --format obj -o surfaces --every 12
[ "$(grep -c '^v ' surfaces/frame_0024.obj)" -eq 26 ] || complain "a surface of another size"
expect 0 export r.safetensors --data d -o cache.pc2
[ "$(stat -c %s cache.pc2)" -eq $((32 + 25 * 26 * 12)) ] && [ -s cache.obj ] ||
  complain "a point cache of another size"
expect 2 export r.safetensors -o e && says "--data"
expect 2 export --mesh m.msh -o e && says "ROLLOUT"
expect 2 export r.safetensors --data d --mesh m.msh -o e && says "both"
expect 2 export --data d --trajectory 2 -o e && says "from 0"
expect 2 export --data d -o e --format usd
expect 3 export m.safetensors --data d -o e && says "tensor 'x'"
expect 5 export missing --data d -o e
(ulimit -f 2 && exec "$nmp" export --data d -o e) >stdout 2>stderr
[ $? -eq 5 ] || complain "frames that cannot be written are not exit code 5"
says "e/frame_0000.vtu: cannot write"
[ -z "$(find . -name '.e.*')" ] || complain "a failed export left its temporary folder"
[ ! -e e ] || complain "a refused export left something"
expect 0 report --model m.safetensors --data d -o r.html --json && is_json
expect 2 report --model m.safetensors --data d -o r.html && says "--force"
expect 0 report --model m.safetensors --data d --eval eval.json --eval eval.json -o two.html
[ "$(grep -c 'data-player>' r.html)" -eq 1 ] || complain "the report has no player"
grep -q "The modules by themselves" two.html || complain "the report lacks the modules' errors"
grep -q "The learned law" two.html || complain "the report lacks the stresses of the law"
expect 0 report --model m.safetensors --data d --eval eval.json --no-player -o plain.html
[ "$(grep -c 'data-player>' plain.html)" -eq 0 ] || complain "--no-player leaves the player in"
expect 0 report --model m.safetensors --data d --eval eval.json --player-megabytes 0.33 -o small.html
[ "$(stat -c %s small.html)" -le 330000 ] || complain "--player-megabytes is not kept"
expect 2 report --model m.safetensors --data d --eval eval.json --player-megabytes 0.2 -o bad.html &&
  says "--player-megabytes"
expect 3 report --model m.safetensors --data d --eval text -o bad.html && says "evaluation 1"
expect 3 report --model m.safetensors --data d --eval eval.json --metrics text -o bad.html &&
  says "line 1"
[ ! -e bad.html ] || complain "a refused report left a file"
expect 5 report --model m.safetensors --data d --eval eval.json -o no_such_folder/r.html

# Motions side by side: records, files, methods.
expect 0 view d -o v.html && prints "RMSE at the end"
expect 0 view --data d --model m.safetensors r.safetensors --methods neural,both=m.safetensors+neural,stvk \
  --trajectory 0 -o five.html --json && is_json && prints '"label": "both"' && prints '"diverged": false'
[ "$(grep -c '"label"' stdout)" -eq 5 ] || complain "view does not show five motions"
[ "$(grep -c 'data-player>' five.html)" -eq 1 ] || complain "the page of view has no player"
grep -qE '(src|href)=|url\(' five.html && complain "the page of view needs a network"
expect 2 view d -o v.html && says "--force"
expect 0 view d a=d:train/000 d:val/001 -o v.html --force --frames 10 && prints "d val/001"
expect 0 view --data d --trajectory 0,1 --stress none --player-megabytes 0.3 -o v.html --force &&
  prints "val/001"
[ "$(stat -c %s v.html)" -le 300000 ] || complain "--player-megabytes is not kept"
expect 2 view --data d --trajectory 0,1,0,1,0,1 --methods stvk,neo-hookean --player-megabytes 0.1 \
  -o bad.html && says "--player-megabytes"
expect 2 view -o bad.html && says "nothing to show"
expect 2 view r.safetensors -o bad.html && says "--data"
expect 2 view --data d --methods nerual --model m.safetensors -o bad.html && says "neo-hookean"
expect 2 view d:val/007 -o bad.html && says "no record" && says "train/000, train/001, val/000"
expect 2 view d --stress neural -o bad.html && says "--model"
expect 2 view d --trajectory 0,x -o bad.html
expect 3 view --data d text -o bad.html && says "text"
expect 3 view --data d m.safetensors -o bad.html && says "m.safetensors"
expect 5 view no_such_folder -o bad.html && says "no such file or folder"
expect 5 view d -o no_such_folder/v.html
[ ! -e bad.html ] || complain "a refused view left a file"
expect 0 grad-check --json && is_json && prints '"group": "rollout"'

# Another program's frames become a dataset; without v and f_int as positions.
expect 0 export --data d --split train -o f0
expect 0 export --data d --split train --trajectory 1 -o f1
around=(--gravity 0,0,-9.8 --ground 0)
expect 0 data import f0/frames.pvd f1/frames.pvd --validation frames/frames.pvd --resample 5e-4 \
  "${around[@]}" -o imported --json && is_json && prints '"validation": 1'
expect 0 data verify imported && prints "5 files, nothing wrong"
expect 0 data info imported && prints "law unknown"
expect 2 data import f0/frames.pvd f1/frames.pvd "${around[@]}" -o imported && says "--force"
expect 0 data import f0/frames.pvd f1/frames.pvd --force --scene d/scene.toml -o imported &&
  says "no validation trajectory" && says "--validation"
cmp <(tail -c 1944 imported/train/001.safetensors) <(tail -c 1944 d/train/001.safetensors) ||
  complain "the last states came back changed"
expect 0 train fast --data imported -o i.safetensors "${quick[@]}"
expect 2 data import f0/frames.pvd -o new && says "--gravity"
expect 2 data import f0/frames.pvd --gravity 9.8 --ground 0 -o new &&
  says "--gravity: expected X,Y,Z, found 1 number"
expect 2 data import f0/frames.pvd "${around[@]}" --E 1e5 -o new && says "--law"
expect 2 data import f0/frames.pvd "${around[@]}" --law stvk -o new && says "--E and --nu"
expect 0 data import f0/frames.pvd --gravity 0,-9.8,0 --ground 0 -o sideways && says "after --up"
expect 2 data import f0/frame_0000.vtu "${around[@]}" -o new && says ".pvd"
expect 3 data import f0/frames.pvd "${around[@]}" --displacement u -o new && says "'u'"
expect 3 data import text.pvd "${around[@]}" -o new && says "text.pvd:1"
expect 5 data import missing.pvd "${around[@]}" -o new
[ ! -e new ] || complain "a refused import left something"

# The positions of a recording whose law nobody knows.
expect 0 train positions --data imported -o p.safetensors --force --set train.constitutive.iterations=3 \
  --set train.joint.iterations=1 --set train.joint.reset_start=8 --set train.joint.reset_end=8 \
  --set train.integration.fit_window=6

# What ships can be read from the program alone.
expect 0 config list && prints "cubexl" && prints "positions"
expect 0 config list --json && is_json
expect 0 config scene cube && cp stdout shipped_cube.toml
expect 0 data gen shipped_cube.toml -o from_shipped "${tiny[@]}"
cmp -s from_shipped/train/000.safetensors d/train/000.safetensors || complain "another cube"
expect 0 config train fast && prints 'method = "windows"'
expect 2 config scene cubex && says "did you mean cube"
expect 2 config train cube && says "accurate"
expect 2 config && says "list, scene, train"

# The pages, and the shell's Tab key.
expect 0 help && prints "formats" && prints "embedding"
expect 0 help formats && prints "manifest.json"
expect 0 help studies && prints "nmp reproduce"
! grep -q -e '<!--' -e '^```sh ' stdout || complain "nmp help shows what only a test reads"
expect 2 help formast && says "did you mean formats"
expect 0 completion bash && cp stdout completion
# completes WANTED WORDS...: what is offered for the last of the words; nothing: files and folders.
completes() {
  local wanted=$1 found
  shift
  # shellcheck disable=SC2016
  found=$(bash -uc 'source ./completion; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _nmp
    echo "${COMPREPLY[*]}"' _ nmp "$@" 2>&1)
  [ "$found" = "$wanted" ] || complain "nmp $*: completed by '$found', expected '$wanted'"
}
completes verify data ver
completes "gen import info verify" data ''
completes "accurate fast friction nclaw paper positions transfer" train ''
completes fast train --data d --max-minutes 5 fa
completes "accurate fast friction nclaw paper positions transfer" config train ''
completes "bob cube cubexl friction spot" data gen ''
completes "cube cubexl" config scene cube
completes '' data gen cube ''
completes '' data gen cube -o ''
completes '' train fast --data ''
completes --checkpoint-minutes train --check
completes "constitutive integration joint all" train fast --stage ''
completes joint train fast --stage = j
completes "bob cube cubexl friction spot" data gen --set time.frames = 20 ''
completes "neural neo-hookean" rollout --constitutive ne
completes semi-implicit rollout --integrator s
completes "val validation" eval --split va
completes "vtu obj pc2" export --format ''
completes "builtin tetgen gmsh" mesh tet body.stl --mesher ''
completes "y z" mesh check --up ''
completes projective fit --law p
completes none view d --stress no
completes "bash zsh" completion ''
completes formats help fo
completes "table1 trajectories transfer" reproduce t
expect 2 completion tcsh && says "bash"

# What the weights say.
expect 0 model info m.safetensors --json && is_json && prints '"E": null'
expect 0 model info m.safetensors --data d --json && is_json && prints '"E": 500000.0'
expect 0 model info m.safetensors --data d && prints "Young's modulus" && prints "1000"
expect 5 model info no_such_model && says "no_such_model" && silent
expect 3 model info r.safetensors && says "not a model"
expect 2 model && says "info"

# Table 1 from a folder of models; the trajectories are made once, and found again.
mkdir -p shipped && cp m.safetensors shipped/cube.safetensors
table=(reproduce table1 --models shipped --scenes cube --scale smoke)
expect 0 "${table[@]}" --json && is_json
for key in scene horizon rmse_mean rmse_std relative_mean coarse_physics staggered_physics \
  affine_only residual_zeroed paper goal verdict diverged; do
  [ "$(grep -c "^   \"$key\":" stdout)" -ge 1 ] || complain "a cell of Table 1 has no $key"
done
kept_at=$(stat -c %Y out/reproduce/cube-2x100/val/000.safetensors)
sleep 1
expect 0 "${table[@]}" && prints "paper" && prints "verdict"
[ "$(stat -c %Y out/reproduce/cube-2x100/val/000.safetensors)" = "$kept_at" ] ||
  complain "reproduce made its trajectories again"
expect 0 reproduce std --models shipped --scenes cube --scale smoke && prints "0.01"
expect 2 reproduce table1 --scenes cub && says "cubexl"
expect 2 reproduce && says "table1"
expect 5 reproduce table1 --scenes cube --scale smoke --work none && says "--models DIR" && says "./models"
expect 5 reproduce table1 --models shipped && says "shipped/cubexl.safetensors"
expect 2 reproduce table1 --scale tiny && says "smoke"
cp m.safetensors shipped/bob.safetensors
NMP_MESHES='' expect 2 reproduce table1 --models shipped --scenes bob && says "bob.msh" && says "NMP_MESHES"

# Every row of the bench has its keys, also one that is skipped; counts are real; a page is kept.
quickly=(--seconds 0 --repetitions 1)
unset NMP_MESHES
expect 0 bench --json "${quickly[@]}" --only svd --only stress_module --only ground_truth \
  --only allocations --only bob_rollout --only stress_mlp_gradient && is_json
for key in name value spread good great verdict note; do
  [ "$(grep -c "^   \"$key\":" stdout)" -ge 5 ] || complain "a row of the bench has no $key"
done
[ "$(grep -cE '"verdict": "(great|good|short|skipped)"' stdout)" -eq 5 ] || complain "no verdict"
prints "--meshes" && prints '"value": null'
expect 0 bench "${quickly[@]}" --only svd --only bob_rollout && prints "skipped"
expect 5 bench "${quickly[@]}" --only bob_rollout --meshes no_such_folder && says "no_such_folder"
sweep=(bench --sweep --vertices 1000 --steps 3 "${quickly[@]}")
expect 0 "${sweep[@]}" --json && is_json && prints '"n_steps": 3'
expect 0 "${sweep[@]}" -o sweep.html && prints "tetrahedra"
grep -q "<svg" sweep.html || complain "the page of the sweep has no plot"
expect 2 "${sweep[@]}" -o sweep.html && says "--force"

# A flipped bit of a trajectory is seen by everything that uses it, before anything is written.
cp -r d damaged
printf '\x5a' | dd of=damaged/val/000.safetensors bs=1 seek=4000 conv=notrunc status=none
expect 3 train fast --data damaged -o n.safetensors "${quick[@]}" && says "checksum"
[ ! -e n.safetensors ] && [ ! -e n.metrics.jsonl ] || complain "a refused training left files"
expect 3 eval --model m.safetensors --data damaged && says "val/000.safetensors: expected"
expect 3 rollout --model m.safetensors --data damaged -o n.safetensors && says "checksum"
expect 0 rollout --model m.safetensors --data damaged -o n.safetensors --trajectory 1
expect 3 view damaged -o n.html && says "checksum"
expect 3 report --model m.safetensors --data damaged --eval eval.json -o n.html && says "checksum"
[ ! -e n.html ] || complain "a refused report left a file"

# 5. A stdout that cannot be written is an error, and no file takes its place.
"$nmp" --version >&- 2>stderr
[ $? -eq 5 ] || complain "a closed stdout is not exit code 5"
"$nmp" rollout --model m.safetensors --data d -o closed.safetensors >&- 2>stderr
[ $? -eq 5 ] || complain "a closed stdout is not exit code 5"
"$nmp" data info d <&- >stdout 2>&- || complain "closed stdin and stderr are an error"
cmp -s closed.safetensors r.safetensors || complain "a closed stdout changed a file"
if [ -w /dev/full ]; then
  "$nmp" data info d >/dev/full 2>stderr
  [ $? -eq 5 ] || complain "a full disk is not exit code 5"
fi

# 6. A stop request saves and says how to go on.
"$nmp" train fast --data d -o s.safetensors "${quick[@]}" --set train.constitutive.iterations=100000000 \
  >stdout 2>stderr &
pid=$!
for _ in $(seq 100); do grep -q constitutive stderr && break; sleep 0.1; done
sleep 1
kill -INT $pid
wait $pid
[ $? -eq 130 ] || complain "an interrupted training does not end with 130"
says "nmp train fast --data d -o s.safetensors --resume"
[ -s s.safetensors ] && [ -s s.metrics.jsonl ] && [ -s s.checkpoint-1.safetensors ] ||
  complain "an interrupted training saved nothing"

# 7. So does the end of the time that it was given.
"$nmp" train fast --data d -o t.safetensors "${quick[@]}" --max-minutes 0.01 \
  --set train.constitutive.iterations=100000000 >stdout 2>stderr
[ $? -eq 130 ] || complain "a training whose time is up does not end with 130"
says "time is up after" && says "nmp train fast --data d -o t.safetensors --resume"
[ -s t.safetensors ] && [ -s t.metrics.jsonl ] && compgen -G 't.checkpoint-*' >/dev/null ||
  complain "a training whose time is up saved nothing"
expect 0 model info t.safetensors --json && prints "stopped early"

finish "all as promised"
