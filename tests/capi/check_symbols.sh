#!/usr/bin/env bash
# What the library gives to a process and takes from it (verification.md LB2):
#   check_symbols.sh LIBNMP.SO LIBNMP.A NMP.H
set -euo pipefail
library=$1 archive=$2 header=$3
status=0
fail() { echo "check_symbols: $*" >&2; status=1; }

declared=$(grep -o '\bnmp_[a-z_]*(' "$header" | tr -d '(' | sort -u)
exported=$(nm -D --defined-only "$library" | awk '{print $3}' | sort -u)
[ "$declared" = "$exported" ] ||
  fail "exports differ from nmp.h:" "$(diff <(echo "$declared") <(echo "$exported") || true)"

inside=$(nm -g --defined-only "$archive" | awk 'NF == 3 {print $3}' | sort -u)
[ "$declared" = "$inside" ] ||
  fail "libnmp.a has other global names than nmp.h:" "$(diff <(echo "$declared") <(echo "$inside") | head || true)"

# Nothing that ends the process, prints, or changes what belongs to the host.
used=$(nm -D --undefined-only "$library" | awk '{print $2}' | sed 's/@.*//'
       readelf -rW "$archive" | awk '{print $5}' | sort -u)  # names in use, not all that were
for symbol in exit _exit quick_exit abort printf puts putchar fputs fputc fwrite vprintf fprintf \
  perror signal sigaction setlocale setenv unsetenv putenv chdir umask system popen fork execve \
  rand srand raise kill sigprocmask __printf_chk __fprintf_chk __vfprintf_chk __assert_fail \
  _ZSt4cout _ZSt4cerr _ZSt4clog; do
  if grep -qx "$symbol" <<<"$used"; then fail "it uses $symbol"; fi
done

# Writable globals of our own, those of threads aside: the table of handles, the number of threads,
# whether the process is a fork, names of laws and of temporary files.
sections=$(readelf -SW "$library" | sed -n 's/^ *\[ *\([0-9]*\)\] \.\(data\|bss\) .*/\1/p' | paste -sd'|')
globals=$(readelf -sW --demangle "$library" |
  awk -v s="^($sections)\$" '$4 == "OBJECT" && $7 ~ s { $1=$2=$3=$4=$5=$6=$7=""; print }' |
  grep 'nmp::' | grep -v 'guard variable for' | sed 's/^ *//; s/\[abi:cxx11\]//g' || true)
[ -n "$globals" ] || fail "readelf names no globals: not even the table of handles"
unknown=$(grep -v -E 'table\(\)::table$|::law_names.*::names$|::contact_law_names.*::names$|::wanted_threads|::forked$|team_for\(long\)::watched$|AtomicFile.*::counter$|kMaterial$|polar_rotation_floors|runs_away\(\)::words$' <<<"$globals" || true)
[ -z "$unknown" ] || fail "writable globals that are not on the list:" "$unknown"
exit $status
