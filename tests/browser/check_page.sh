#!/usr/bin/env bash
# A page of nmp in a headless Chromium. Exit status 77 if what it takes is not installed.
#   check_page.sh check_report.py path/to/nmp folder-for-screenshots
set -u
if ! command -v python3 >/dev/null; then
  echo "skipped: missing python3"
  exit 77
fi
script=$1
shift
exec python3 -B "$(dirname "${BASH_SOURCE[0]}")/$script" "$@"
