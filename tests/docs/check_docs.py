#!/usr/bin/env python3
"""Runs what the documentation prints.

    check_docs.py [--full] PAGE.md ...

Each page in an empty folder of its own, in the order of the page:
  ```sh            commands, by bash -euo pipefail
  ```sh meshes     the same, where NMP_MESHES names the folder of BOB and SPOT; DIR is that folder
  ```sh full       the same, minutes long: with --full alone
  ```sh started    commands of minutes or hours: each must still run after some seconds, or be done
  ```sh elsewhere  commands that cannot run in a test; only their nmp options are looked at
  ```toml a.toml   a file that the commands find
  <!-- sh ... -->  commands that readers need not see, with the same marks
The programs that it runs are those on PATH. Commands may continue what earlier fences made. Of every nmp
command, also those that are not run, each option must be known to its --help.
"""
import argparse
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import time

FENCE = re.compile(r"^( *)```(.*)$")


def pieces(text):
    """(line, kind, words after the kind, content) of each fence and hidden command."""
    lines = text.split("\n")
    i = 0
    while i < len(lines):
        fence = FENCE.match(lines[i])
        hidden = re.match(r"^<!-- sh\b", lines[i])
        if not fence and not hidden:
            i += 1
            continue
        start, body = i + 1, []
        end = "-->" if hidden else "```"
        i += 1
        while i < len(lines) and lines[i].strip() != end:
            body.append(lines[i])
            i += 1
        if i == len(lines):
            raise SystemExit(f"line {start}: the fence is not closed")
        words = lines[start - 1][5:].split() if hidden else fence.group(2).split()
        yield start, words[0] if words else "", words[1:], "\n".join(body) + "\n"
        i += 1


def nmp_commands(script):
    """The nmp commands of a script, each as its words; comments and continuations are understood."""
    for line in script.replace("\\\n", " ").split("\n"):
        if "nmp" not in line:
            continue
        words = shlex.split(line, comments=True)
        for k, word in enumerate(words):
            if word == "nmp" and (k == 0 or words[k - 1] in ("&&", "|", ";", "time", "then")):
                rest = words[k + 1:]
                for stop, w in enumerate(rest):
                    if w in ("&&", "|", ";", ">", "||", "2>", "&"):
                        rest = rest[:stop]
                        break
                yield rest


class Help:
    """Options of subcommands, asked of the program once each."""

    def __init__(self):
        self._known = {}

    def of(self, words):
        path = tuple(words)
        if path not in self._known:
            run = subprocess.run(["nmp", *path, "--help"], capture_output=True, text=True)
            self._known[path] = run.stdout if run.returncode == 0 else None
        return self._known[path]

    def check(self, words):
        """What is wrong with a command; empty if nothing is."""
        path = []
        while len(path) < len(words) and re.fullmatch(r"[a-z][a-z0-9-]*", words[len(path)]):
            if self.of([*path, words[len(path)]]) is None or len(path) == 2:
                break
            path.append(words[len(path)])
        if not path and not any(w.startswith("-") for w in words):
            return f"there is no command nmp {' '.join(words)}"
        text = self.of(path) or ""
        for word in words[len(path):]:
            option = re.match(r"--[a-z0-9-]+", word, re.I)
            if option and option.group() not in ("--help", "--version"):
                if not re.search(re.escape(option.group()) + r"(?![a-z0-9-])", text):
                    return f"nmp {' '.join(path)} has no option {option.group()}"
        return ""


def start_each(script, folder, seconds=3):
    """What is wrong with each command on its own: it may end well, or still run and end when told."""
    for line in script.replace("\\\n", " ").split("\n"):
        if not line.strip():
            continue
        process = subprocess.Popen(["bash", "-c", "exec " + line], cwd=folder, text=True,
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                   stderr=subprocess.STDOUT)
        try:
            output, _ = process.communicate(timeout=seconds)
            if process.returncode != 0:
                yield f"exit status {process.returncode} of\n{line}\n{output[-1500:]}"
        except subprocess.TimeoutExpired:
            process.terminate()
            try:
                process.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
                yield f"still runs a minute after it was told to end: {line}"


def run_page(page, options, known):
    failures, n_run, skipped, start = [], 0, [], time.monotonic()
    meshes = os.environ.get("NMP_MESHES")
    with tempfile.TemporaryDirectory() as folder:
        if meshes:
            os.symlink(os.path.abspath(meshes), os.path.join(folder, "DIR"))
        for line, kind, words, body in pieces(page.read_text()):
            where = f"{page.name}:{line}"
            if kind != "sh":
                if words and kind != "text":
                    target = pathlib.Path(folder, words[0])
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_text(body)
                continue
            for command in nmp_commands(body):
                wrong = known.check(command)
                if wrong:
                    failures.append(f"{where}: {wrong}")
            for mark in set(words) - {"meshes", "full", "started", "elsewhere"}:
                failures.append(f"{where}: there is no mark '{mark}'")
            why = ("not for tests" if "elsewhere" in words else
                   "NMP_MESHES is not set" if "meshes" in words and not meshes else
                   "without --full" if "full" in words and not options.full else "")
            if why:
                skipped.append(f"{where}: {why}")
                continue
            n_run += 1
            if "started" in words:
                failures += [f"{where}: {what}" for what in start_each(body, folder)]
                continue
            result = subprocess.run(["bash", "-euo", "pipefail", "-c", body], cwd=folder,
                                    stdin=subprocess.DEVNULL, capture_output=True, text=True)
            if result.returncode != 0:
                failures.append(f"{where}: exit status {result.returncode} of\n{body}"
                                f"{result.stdout[-1500:]}{result.stderr[-1500:]}")
                break
    seconds = time.monotonic() - start
    print(f"{page.name}: {n_run} fences run in {seconds:.0f} s, {len(skipped)} not", flush=True)
    for note in skipped:
        print(f"  SKIPPED {note}")
    return failures


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("pages", nargs="+", type=pathlib.Path)
    options = parser.parse_args()
    failures = []
    known = Help()
    for page in options.pages:
        failures += run_page(page, options, known)
    for failure in failures:
        print(f"FAILED {failure}", file=sys.stderr)
    sys.exit(1 if failures else 0)


main()
