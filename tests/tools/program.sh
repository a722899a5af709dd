# For the scripts beside it, which source it with the path of nmp: an empty working folder that goes
# when the script ends, and what one says about a run. Sets nmp and work; finish ends the script.
nmp=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"
export OMP_WAIT_POLICY=passive  # waiting threads that spin would starve tests beside each other
cd "$work" || exit 1
failures=0
runs=0

complain() {
  printf 'FAILED: %s\n' "$*" >&2
  [ -s stderr ] && tail -n 20 stderr | head -c 2000 | sed 's/^/  | /' >&2
  failures=$((failures + 1))
}
skip() { printf 'SKIPPED: %s\n' "$*"; }

# expect CODE ARGUMENTS...: runs nmp, leaving stdout and stderr in files of these names. An error
# says something, in lines of bounded length and without control characters.
expect() {
  local wanted=$1 code shown
  shift
  timeout 600 "$nmp" "$@" </dev/null >stdout 2>stderr
  code=$?
  runs=$((runs + 1))
  shown=$(printf '%s ' "$@" | head -c 200)
  [ $code -eq "$wanted" ] || complain "nmp $shown: exit code $code, expected $wanted"
  if [ "$wanted" -ne 0 ]; then
    [ -s stderr ] || complain "nmp $shown: no word on stderr"
    [ ! -s stdout ] || [ "$wanted" -eq 4 ] || [ "${2-}" = verify ] || [ "${2-}" = check ] ||
      complain "nmp $shown: an error, and something on stdout"
    [ "$(wc -c <stderr)" -lt 20000 ] || complain "nmp $shown: a message of $(wc -c <stderr) bytes"
    LC_ALL=C grep -q '[[:cntrl:]]' stderr && complain "nmp $shown: control characters on stderr"
  fi
}
says() { grep -qF -- "$1" stderr || complain "stderr does not say: $1"; }
prints() { grep -qF -- "$1" stdout || complain "stdout does not hold: $1"; }
silent() { [ ! -s stdout ] || complain "something was printed on stdout"; }
# One JSON document and nothing else: it begins with { and ends with }, both alone at the margin.
is_json() {
  [ "$(head -c 1 stdout)" = "{" ] && [ "$(tail -n 1 stdout)" = "}" ] &&
    [ "$(grep -c '^[^ ]' stdout)" -eq 2 ] || complain "stdout is not one JSON document"
}

# finish MESSAGE: says that all went well, if it did.
finish() {
  [ $failures -eq 0 ] || exit 1
  echo "$1"
  exit 0
}
