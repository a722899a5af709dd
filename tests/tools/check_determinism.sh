#!/usr/bin/env bash
# The same bits for any number of threads, and in every run (DT1, DT2).
#   check_determinism.sh path/to/nmp
set -u
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

# everything THREADS: a dataset, 20 steps of every stage, 1000 frames; prints a hash of the results.
everything() {
  rm -rf d m.safetensors m.metrics.jsonl r.safetensors
  "$nmp" data gen cube -o d --threads "$1" --set mesh.vertices_per_edge=5 --set time.frames=1000 \
    --set time.dt=1e-4 --set time.substeps=5 --set material.E=1e5 --set dataset.train=3 \
    --set dataset.validation=1 &&
    "$nmp" train fast --data d -o m.safetensors --threads "$1" \
      --set train.constitutive.iterations=20 --set train.integration.iterations=20 \
      --set train.integration.fit_window=20 --set train.joint.iterations=20 \
      --set train.joint.reset_start=10 --set train.joint.reset_end=20 &&
    "$nmp" rollout --model m.safetensors --data d -o r.safetensors --threads "$1" --frames 1000
} >stdout 2>stderr
hash_of() {
  if everything "$1"; then
    cat d/manifest.json d/*/*.safetensors m.safetensors r.safetensors | cksum
  else
    echo "failed: $(tail -n 1 stderr)"
  fi
}

# 1. Threads, more than there are cores too.
first=$(hash_of 1)
case $first in failed*) complain "1 thread: $first"; finish "" ;; esac
for threads in 2 3 4 7 8 16; do
  [ "$(hash_of $threads)" = "$first" ] || complain "$threads threads give other bits than 1"
done

# 2. Twenty runs, each in an environment of another size, addresses at random.
for i in $(seq 20); do
  padding=$(head -c $((i * 371)) /dev/zero | tr '\0' x)
  rm -f r.safetensors
  PADDING=$padding "$nmp" rollout --model m.safetensors --data d -o r.safetensors --frames 1000 \
    >stdout 2>stderr || complain "run $i failed"
  sum=$(cksum <r.safetensors)
  [ "${wanted:=$sum}" = "$sum" ] || complain "run $i of the same rollout gives other bits"
done

finish "the same bits: 1, 2, 3, 4, 7, 8, 16 threads; 20 runs"
