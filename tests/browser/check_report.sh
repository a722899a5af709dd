#!/usr/bin/env bash
# The report in a headless Chromium. Exit status 77 if what it takes is not installed.
#   check_report.sh path/to/nmp folder-for-screenshots
set -u
if ! command -v python3 >/dev/null; then
  echo "skipped: missing python3"
  exit 77
fi
exec python3 -B "$(dirname "${BASH_SOURCE[0]}")/check_report.py" "$@"
