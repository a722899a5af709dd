#!/usr/bin/env bash
# bench/pytorch.py checks its own code, and prints every ratio. Exit 77 without Debian's PyTorch.
#   check_pytorch.sh path/to/nmp
set -u
script=$(realpath "$(dirname "${BASH_SOURCE[0]}")/../../bench/pytorch.py")
# shellcheck source=tests/tools/program.sh
source "$(dirname "${BASH_SOURCE[0]}")/program.sh"
unset NMP_MESHES

/usr/bin/python3 -c "import torch" 2>stderr ||
  { echo "skipped: no PyTorch (apt-get install python3-torch libopenblas0-pthread)"; exit 77; }
"$script" --nmp "$nmp" --rounds 2 --repetitions 1 --json >stdout 2>stderr ||
  complain "bench/pytorch.py: exit code $?"
is_json
for key in name value spread torch_seconds; do
  [ "$(grep -c "^   \"$key\":" stdout)" -ge 8 ] || complain "a row has no $key"
done
[ "$(grep -cE '"verdict": "(great|good|short)"' stdout)" -eq 2 ] || complain "two rows have goals"
for fact in blas onednn cpu_capability torch_threads; do prints "\"$fact\":"; done
prints '"gradient_finite_custom": true'
"$script" --nmp no_such_program --rounds 1 >stdout 2>stderr && complain "a missing nmp is no error"
says no_such_program
finish "all as promised"
