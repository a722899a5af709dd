#!/usr/bin/env bash
# Stops a training in every way a machine can, resumes it, and compares with one that never stopped.
#   check_resume.sh path/to/nmp
set -u
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"

# 1. What the run ends with if nothing stops it.
"$nmp" data gen cube -o d --set mesh.vertices_per_edge=3 --set time.frames=24 --set time.dt=1e-4 \
  --set time.substeps=5 --set dataset.train=3 --set dataset.validation=1 \
  --set initial.clearance=0.001 >stdout 2>stderr ||
  complain "no dataset"
settings=(--data d --set train.constitutive.iterations=900 --set train.constitutive.batch=64
  --set train.constitutive.select_every=200 --set train.integration.iterations=150
  --set train.integration.batch=64 --set train.integration.fit_window=6
  --set train.integration.window_start=4 --set train.integration.window_end=8
  --set train.joint.iterations=25 --set train.joint.reset_start=8 --set train.joint.reset_end=8)
begin=$(date +%s%N)
"$nmp" train fast "${settings[@]}" -o whole.safetensors >stdout 2>stderr || complain "no training"
whole_ms=$((($(date +%s%N) - begin) / 1000000))
clockless() { sed 's/"seconds":[^,}]*//' "$1"; }
clockless whole.metrics.jsonl >whole.lines

# same NAME: whether NAME ended as the uninterrupted run did.
same() {
  cmp -s "$1.safetensors" whole.safetensors || complain "$1: another model"
  clockless "$1.metrics.jsonl" | cmp -s - whole.lines || complain "$1: other metrics"
  [ ! -e "$1.checkpoint-0.safetensors" ] && [ ! -e "$1.checkpoint-1.safetensors" ] ||
    complain "$1: a checkpoint is left"
}
# resume NAME: goes on to the end.
resume() {
  "$nmp" train fast "${settings[@]}" -o "$1.safetensors" --resume >stdout 2>stderr ||
    complain "$1: cannot be resumed"
  same "$1"
}
# start NAME ARGUMENTS...: in the background; its process is $pid.
start() {
  local name=$1
  shift
  "$nmp" train fast "${settings[@]}" -o "$name.safetensors" "$@" >stdout 2>stderr &
  pid=$!
}
moment() { # moment I OF: sleeps for I / OF of what the whole run takes
  sleep "$(awk "BEGIN { print $whole_ms / 1000 * $1 / $2 }")"
}
ended() { wait "$pid" 2>/dev/null; code=$?; }

# 2. Signals: the step ends, a checkpoint is written, the run says how to go on (CK6).
i=0
interrupted=0
for signal in TERM INT HUP TERM INT HUP; do
  i=$((i + 1))
  start "s$i"
  moment $i 8
  begin=$(date +%s)
  kill -$signal $pid 2>/dev/null
  ended
  [ $(($(date +%s) - begin)) -le 5 ] || complain "SIG$signal: took more than 5 s"
  case $signal in TERM) wanted=143 ;; INT) wanted=130 ;; HUP) wanted=129 ;; esac
  if [ $code -ne 0 ]; then
    interrupted=$((interrupted + 1))
    if [ -e "s$i.metrics.jsonl" ]; then # it had begun
      [ $code -eq $wanted ] || complain "SIG$signal: exit code $code, expected $wanted"
      says "--resume"
    fi
  fi
  resume "s$i"
done
[ $interrupted -ge 3 ] || complain "only $interrupted of 6 runs were interrupted"

# 3. A second signal ends it at once; kill -9 at any moment; resumed all the same (CK1, CK6).
for i in 1 2 3 4 5 6; do
  start "k$i" --checkpoint-minutes 0
  moment $i 7
  if [ $i -le 2 ]; then
    kill -TERM $pid 2>/dev/null
    kill -TERM $pid 2>/dev/null
    ended
    [ $code -eq 143 ] || [ $code -eq 0 ] || complain "two signals: exit code $code"
  else
    kill -KILL $pid 2>/dev/null
    ended
  fi
  resume "k$i"
done

# 4. A limit on the size of files: an error (5), and the checkpoints before it are intact (CK4).
start full --checkpoint-minutes 0
moment 1 3
kill -TERM $pid
ended
if [ $code -eq 143 ] && [ -e full.checkpoint-1.safetensors ]; then
  sum=$(cat full.checkpoint-*.safetensors | cksum)
  (
    ulimit -f 40
    "$nmp" train fast "${settings[@]}" -o full.safetensors --resume --checkpoint-minutes 0
  ) >stdout 2>stderr
  [ $? -eq 5 ] || complain "a file that may not grow is not exit code 5"
  # Whichever of them is the first to meet the limit.
  grep -qE "full\.(checkpoint-|metrics\.)" stderr || complain "stderr does not name the file"
  [ "$sum" = "$(cat full.checkpoint-*.safetensors | cksum)" ] ||
    complain "a checkpoint that could not be written damaged the old ones"
  resume full
else
  skip "file-size limit: the run was over too soon"
fi

# 5. A full disk; training may go on with a warning (CK4).
mkdir disk
if mount -t tmpfs -o size=600k tmpfs disk 2>/dev/null; then
  head -c 500000 /dev/zero >disk/filler
  "$nmp" train fast "${settings[@]}" -o disk/m.safetensors --checkpoint-minutes 0 >stdout 2>stderr
  [ $? -eq 5 ] || complain "a full disk is not exit code 5"
  says "free some space"
  [ -z "$(find disk -name '.*.tmp')" ] || complain "a full disk leaves temporary files"
  rm -f disk/m.* disk/filler
  head -c 350000 /dev/zero >disk/filler
  "$nmp" train fast "${settings[@]}" -o disk/m.safetensors --checkpoint-minutes 0 \
    --ignore-save-errors >stdout 2>stderr
  code=$?
  says "no checkpoint was saved"
  if [ $code -eq 0 ]; then same disk/m; else [ $code -eq 5 ] || complain "exit code $code"; fi
  umount disk
else
  skip "full disk: no tmpfs can be mounted here"
fi

# 6. A folder that may not be written.
mkdir closed && chmod 555 closed
as_nobody=()
[ "$(id -u)" -ne 0 ] || as_nobody=(setpriv --reuid 65534 --regid 65534 --clear-groups)
if "${as_nobody[@]}" "$nmp" --version >/dev/null 2>&1; then
  "${as_nobody[@]}" "$nmp" train fast "${settings[@]}" -o closed/m.safetensors >stdout 2>stderr
  [ $? -eq 5 ] || complain "a read-only folder is not exit code 5"
  says "permissions"
else
  skip "read-only folder: the program cannot be run as another user here"
fi

finish "all resumed ($interrupted of 6 runs stopped by a signal)"
