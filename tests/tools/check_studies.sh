#!/usr/bin/env bash
# Every study of nmp reproduce at its smallest, with the models that ship: numbers as JSON, a table
# for people, a section of one report; what was made is found again. Those on BOB and SPOT need
# NMP_MESHES.
#   check_studies.sh path/to/nmp path/to/models
set -u
models=$(realpath "$2")
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

declare -A holds=(
  [trajectories]='"validation": [' [unseen]='"spin": 5.0' [resolution]='"stable_time_step": 0.00'
  [volume]='"hinge on, 0.1": {' [model-size]='"force_error": ' [interchange]='"stvk": {'
  [collapse]='"largest_force_ratio": ' [efficiency]='"paper_seconds": 2.25'
  [laws]='"angular_momentum_drift": '
  [failure]='"largest_distance": '
  [friction]='"flight_velocity_change": ' [sysid]='"worst_relative_error": 0.00'
  [transfer]='"fine-tuned from positions": {' [volume-weight]='"1e+03": {'
)
studies=(trajectories unseen resolution volume model-size laws sysid transfer volume-weight)
if [ -n "${NMP_MESHES-}" ]; then
  studies+=(interchange collapse efficiency failure friction)
else
  skip "interchange, collapse, efficiency, failure, friction: set NMP_MESHES to a folder with" \
    "bob.msh, bob_fine.msh, spot.msh"
fi
smoke=(--scale smoke --models "$models")
for study in "${studies[@]}"; do
  expect 0 reproduce "$study" "${smoke[@]}" --json && is_json
  prints "\"study\": \"$study\"" && prints '"scale": "smoke"' && prints "${holds[$study]}"
  grep -q "<section id=\"$study\">" out/reproduce/report.html ||
    complain "the report has no section on $study"
done
[ "$(grep -c '<section id=' out/reproduce/report.html)" -eq ${#studies[@]} ] ||
  complain "the report has not one section for each of ${#studies[@]} studies"
grep -q 'nan\|NaN' out/reproduce/report.html && complain "the report holds something not a number"

# Found again: trajectories, a trained model, and the other sections.
models_made() { stat -c '%n %Y' out/reproduce/*-hinge-*.safetensors out/reproduce/*-law-*.safetensors; }
made=$(models_made)
[ "$(wc -l <<<"$made")" -ge 6 ] || complain "the studies left too few of their models"
sleep 1
expect 0 reproduce volume "${smoke[@]}" && prints "hinge off" && prints "out/reproduce/report.html"
[ "$(models_made)" = "$made" ] || complain "a study trained its models again"
# From another start they are other models, with files of their own.
mkdir other && cp "$models/cube-density.safetensors" other/cube.safetensors
expect 0 reproduce volume --scale smoke --models other
[ "$(models_made | wc -l)" -eq $(($(wc -l <<<"$made") + 3)) ] ||
  complain "a study took models that were made from another start"

expect 5 reproduce unseen --scale smoke --models no_such_folder && says "no_such_folder/cube.safetensors"
NMP_MESHES='' expect 2 reproduce failure "${smoke[@]}" && says "bob.msh" && says "NMP_MESHES"
expect 2 reproduce unseen --scale tiny && says "smoke"
echo '{' >out/reproduce/studies/unseen.json
expect 3 reproduce trajectories "${smoke[@]}" --json && says "unseen.json"
finish "${#studies[@]} studies did what they should"
