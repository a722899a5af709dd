#!/usr/bin/env bash
# What libnmp.so gives to a process and takes from it (verification.md LB2):
#   check_symbols.sh LIBNMP.SO NMP.H
set -euo pipefail
library=$1 header=$2
status=0
fail() { echo "check_symbols: $*" >&2; status=1; }

declared=$(grep -o '\bnmp_[a-z_]*(' "$header" | tr -d '(' | sort -u)
exported=$(nm -D --defined-only "$library" | awk '{print $3}' | sort -u)
[ "$declared" = "$exported" ] ||
  fail "exports differ from nmp.h:" "$(diff <(echo "$declared") <(echo "$exported") || true)"

# Nothing that ends the process, prints, or changes what belongs to the host.
used=$(nm -D --undefined-only "$library" | awk '{print $2}' | sed 's/@.*//')
for symbol in exit _exit quick_exit abort printf puts putchar fputs fputc fwrite vprintf fprintf \
  perror signal sigaction setlocale setenv unsetenv putenv chdir umask system popen fork execve \
  rand srand; do
  if grep -qx "$symbol" <<<"$used"; then fail "it uses $symbol"; fi
done

# Writable globals of our own, those of threads aside: the table of handles, the number of threads,
# names of laws and of temporary files.
sections=$(readelf -SW "$library" | sed -n 's/^ *\[ *\([0-9]*\)\] \.\(data\|bss\) .*/\1/p' | paste -sd'|')
globals=$(readelf -sW --demangle "$library" |
  awk -v s="^($sections)\$" '$4 == "OBJECT" && $7 ~ s { $1=$2=$3=$4=$5=$6=$7=""; print }' |
  grep 'nmp::' | grep -v 'guard variable for' | sed 's/^ *//; s/\[abi:cxx11\]//g' || true)
[ -n "$globals" ] || fail "readelf names no globals: not even the table of handles"
unknown=$(grep -v -E 'table\(\)::table$|::law_names.*::names$|::contact_law_names.*::names$|::wanted_threads|AtomicFile.*::counter$|kMaterial$|polar_rotation_floors|runs_away\(\)::words$' <<<"$globals" || true)
[ -z "$unknown" ] || fail "writable globals that are not on the list:" "$unknown"
exit $status
