#!/usr/bin/env bash
# The example in Python, by the system's Python; exit status 77 if that has no NumPy.
#   check_numpy.sh NMP EXAMPLES-FOLDER LIBNMP.SO
set -euo pipefail
PATH=/usr/bin:$PATH
python3 -c 'import numpy' 2>/dev/null || { echo "skipped: $(command -v python3) has no NumPy"; exit 77; }
mesh=$(mktemp --suffix .msh)
trap 'rm -f "$mesh"' EXIT
"$1" mesh box --size 1,1,1 --cells 3,3,3 -o "$mesh" --force >/dev/null
python3 "$2/nmp_numpy.py" "$3" "$mesh"
