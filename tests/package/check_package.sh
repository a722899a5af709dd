#!/usr/bin/env bash
# The packages of tools/package on a clean root: nothing there but what they hold.
#   check_package.sh DIST [LEVEL...]   that was built by tools/package --levels "LEVEL..."
# Needs to be root, or user namespaces (unshare), for chroot.
set -euo pipefail
dist=$(realpath "$1")
levels=("${@:2}")
work=$(mktemp -d)
trap 'umount "$work/root/proc" 2>/dev/null || true; rm -rf "$work"' EXIT
fail() { echo "check_package: $*" >&2; exit 1; }

cd "$dist"
sha256sum --quiet -c SHA256SUMS
deb=$(ls nmp*.deb) tar=$(ls nmp*.tar.gz)

# chroot without anything else: a static program needs no loader, no library, no /proc.
inside() { chroot "$work/root" "$@"; }
if [ "$(id -u)" != 0 ]; then inside() { unshare -r chroot "$work/root" "$@"; }; fi

try_all() {
  local nmp=$1
  inside "$nmp" --version
  inside "$nmp" mesh box --size 1,1,1 --cells 3,3,3 -o /box.msh
  inside "$nmp" data gen --mesh /box.msh --set dataset.train=2 --set dataset.validation=1 \
    --set time.frames=400 -o /data
  inside "$nmp" train fast --data /data --set train.constitutive.iterations=20 \
    --set train.joint.iterations=1 -o /box.safetensors
  inside "$nmp" eval --model /box.safetensors --data /data --json >eval.json
  [ -s eval.json ] || fail "nmp eval printed nothing"
}

echo "==== $tar"
rm -rf "$work/root" && mkdir "$work/root" && cd "$work"
tar -xzf "$dist/$tar" -C root --strip-components=1
file root/bin/nmp | grep -q 'statically linked' || fail "bin/nmp is not static"
inside /bin/nmp --version | grep -q 'x86-64$' || fail "without /proc it must run as it is"
try_all /bin/nmp

echo "==== $deb"
rm -rf root && mkdir root
dpkg-deb -x "$dist/$deb" root
inside /usr/bin/nmp --version
# Where /proc tells the program where it is, it starts the build for this processor.
for level in "${levels[@]}"; do
  [ -x "root/usr/libexec/nmp/nmp-$level" ] || fail "the package lacks nmp-$level"
  [ -n "$(find root/usr/lib -path "*/glibc-hwcaps/$level/libnmp.so.*")" ] ||
    fail "the package lacks libnmp.so for $level"
done
mkdir root/proc
if [ "$(id -u)" = 0 ] && mount -t proc proc root/proc 2>/dev/null; then
  for level in "${levels[@]}"; do
    if NMP_CPU=$level inside /usr/bin/nmp --version >version 2>error; then
      grep -q " $level\$" version || fail "NMP_CPU=$level started $(cat version)"
      echo "$(cat version): started"
      best=$level
    else
      grep -q 'which this processor does not support' error || fail "$(cat error)"
      echo "SKIPPED: $level, this processor is none"
    fi
  done
  inside /usr/bin/nmp --version | grep -q " ${best:-x86-64}\$" || fail "not the best level was started"
  if NMP_CPU=pentium inside /usr/bin/nmp --version 2>error; then fail "NMP_CPU=pentium was taken"; fi
  umount root/proc
else
  echo "SKIPPED: the choice of a build, proc cannot be mounted"
fi
dpkg-deb -f "$dist/$deb" Depends | grep -q libc6 || fail "the libraries' dependencies are missing"
for file in bin/nmp include/nmp.h include/nmp/nmp/rollout.h share/bash-completion/completions/nmp \
  share/doc/nmp/docs/embedding.md share/doc/nmp/examples/minimal.c; do
  [ -s "root/usr/$file" ] || fail "the package lacks /usr/$file"
done
for name in libnmp.a libnmp.so nmp.pc nmpConfig.cmake; do
  [ -n "$(find root/usr/lib -name "$name")" ] || fail "the package lacks $name"
done
bash -n root/usr/share/bash-completion/completions/nmp
echo "check_package: passed"
